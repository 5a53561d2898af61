"""Time and memory that a simulation will need, estimated before it starts.

The number of particles follows from bed and grid, that of steps from the motion; the time for both
is good to a factor of about two. Simulations that need more memory than there is, or more than a
year, are refused.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from terraphi.experiment.errors import InputError
from terraphi.experiment.motion import bin_count
from terraphi.experiment.scenario import Scenario

PARTICLE_STEPS_PER_SECOND = 6e7
"""Particles times steps that one core with vectors of 512 bits works off in a second [1/s],
measured on the shipped libraries."""
PARTICLE_STEPS_PER_SECOND_IN_SPACE = 2.5e7
"""The same in three dimensions [1/s], with what packing and transfer take."""
SLOWER = {512: 1.0, 256: 1.5, 128: 2.9}
"""By width of the vectors [bit], how many times longer a simulation takes than with 512 bits [-]:
medians of four turns of ``make bench`` on one processor (AMD EPYC with AVX-512), compiled for each
width."""
ELEMENT_POSES_PER_SECOND = 5e6
"""Elements of the leg times poses that one core works off in a second by resistive force theory
[1/s]."""
BYTES_AT_REST = {"mpm": 350e6, "rft": 150e6}
"""Memory of a process besides its simulation, by model [byte], measured; most of it is taken by
compiling the kernels."""
BYTES = {"particle": 600.0, "node": 200.0, "bin": 200.0}
"""Memory for each particle, node of the grid and bin of the history [byte]: measured, with the
copies that are made of them and with a checkpoint being written, and rounded up."""
BYTES_IN_SPACE = {"particle": 190.0, "node": 100.0, "bin": 200.0}
"""The same in three dimensions, in single precision."""
COMPILING_SECONDS = 20.0
"""Time that the first simulation of a kind, with or without phases or in space, takes to compile
its kernels [s]."""
YEAR = 365.25 * 86400.0
"""A year [s]: simulations that would take longer are refused."""
_UNITS = ((YEAR, "years"), (86400.0, "days"), (3600.0, "hours"), (60.0, "minutes"), (0.0, "s"))


@dataclass(frozen=True)
class Forecast:
    """Rough time and memory that one simulation or several will need.

    Attributes
    ----------
    simulations
        Number of simulations.
    particles
        Particles of the largest one; 0 for resistive force theory.
    particle_steps
        Particles times steps, summed over all of them.
    core_seconds
        Time for all of them, one after another on one core [s].
    longest_seconds
        Time for the longest one [s].
    bytes
        Memory for the largest one [byte].
    compiling_seconds
        Time that compiling takes before [s]; 0 where the kernels are there.
    """

    simulations: int
    particles: float
    particle_steps: float
    core_seconds: float
    longest_seconds: float
    bytes: float
    compiling_seconds: float = 0.0

    def seconds(self, workers: int = 1) -> float:
        """Time for all of them on ``workers`` cores, without compiling [s]."""
        return max(self.core_seconds / workers, self.longest_seconds)

    def memory(self, workers: int = 1) -> float:
        """Memory when ``workers`` of them run at the same time [byte]."""
        return self.bytes * min(workers, self.simulations)

    def sentence(self, workers: int = 1) -> str:
        """The forecast as a sentence, for ``workers`` cores."""
        some = "1 simulation" if self.simulations == 1 else f"{self.simulations:,} simulations"
        size = f" of {self.particles:,.0f} particles" if self.particles else ""
        steps = f", {self.particle_steps:.2g} particle-steps" if self.particles else ""
        once = self.compiling_seconds
        compiling = f", and {lasting(once)} of compiling at first use" if once else ""
        return (
            f"forecast: {some}{size}{steps}: {lasting(self.seconds(workers))} on "
            f"{_cores(workers)}, {_size(self.memory(workers))} of memory{compiling}"
        )

    def as_dict(self, workers: int = 1) -> dict[str, Any]:
        """The forecast as JSON-able numbers, for ``workers`` cores."""
        return {
            "simulations": self.simulations,
            "particles": round(self.particles),
            "particle_steps": self.particle_steps,
            "seconds": self.seconds(workers),
            "compiling_seconds": self.compiling_seconds,
            "memory_bytes": self.memory(workers),
            "cores": workers,
        }


def forecast(
    scenarios: Iterable[Scenario], *, register_bits: int = 512, compiling_seconds: float = 0.0
) -> Forecast:
    """Time and memory that some simulations will need.

    Parameters
    ----------
    scenarios
        May be none, where everything is there already.
    register_bits
        Width of the vectors of the machine that simulates [bit].
    compiling_seconds
        Time that it takes to compile its kernels [s].
    """
    each = [_of_one(scenario, register_bits) for scenario in scenarios]
    return Forecast(
        len(each),
        max((one.particles for one in each), default=0.0),
        sum(one.particle_steps for one in each),
        sum(one.core_seconds for one in each),
        max((one.longest_seconds for one in each), default=0.0),
        max((one.bytes for one in each), default=0.0),
        compiling_seconds,
    )


def foreseen(scenarios: Sequence[Scenario]) -> Forecast:
    """Time and memory that some simulations will need here, compiling included.

    Parameters
    ----------
    scenarios
        May be none, where everything is there already.
    """
    needed = {code for code in map(code_for, scenarios) if code is not None}
    if not needed:
        return forecast(scenarios)
    from terraphi.forward.plane import packing

    compiling = COMPILING_SECONDS * sum(not is_compiled(code) for code in needed)
    return forecast(scenarios, register_bits=packing.register_bits(), compiling_seconds=compiling)


class Code(NamedTuple):
    """Which of the kernels' machine code a simulation needs."""

    dimensions: int = 2
    """Of the scenario."""
    phases: bool = False
    """Whether the grid keeps its velocities for a while; in space it always does."""


IN_PLANE = Code()
"""Of a transfer at every step, in plane strain."""


def code_for(scenario: Scenario) -> Code | None:
    """The machine code that a scenario needs; ``None`` for resistive force theory."""
    if scenario.model != "mpm":
        return None
    space = scenario.dimensions == 3
    return Code(scenario.dimensions, not space and scenario.numerics.steps_per_phase > 0)


def place_of_code(code: Code = IN_PLANE) -> tuple[Path | None, str]:
    """Where machine code of the kernels is kept: folder, or ``None`` for nowhere, and name."""
    outermost: Any  # Numba's types do not tell that a function has statistics.
    if code.dimensions == 3:
        from terraphi.forward.mpm.phase import step as outermost
    elif code.phases:
        from terraphi.forward.plane.packet_phases import march as outermost
    else:
        from terraphi.forward.plane.packets import march as outermost
    file = outermost.__module__.rpartition(".")[2]
    folder = outermost.stats.cache_path
    return Path(folder) if folder else None, f"{file}.{outermost.__name__}-*.nbi"


def is_compiled(code: Code = IN_PLANE) -> bool:
    """Whether machine code of the kernels lies in the cache, or needs no compiling."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return True
    place, name = place_of_code(code)
    return place is not None and any(place.glob(name))


def compiles(scenarios: Iterable[Scenario]) -> bool:
    """Whether kernels have to be compiled before some scenarios can be simulated here."""
    needed = {code for code in map(code_for, scenarios) if code is not None}
    return not all(map(is_compiled, needed))


def refuse_what_cannot_fit(scenario: Scenario, *, memory: float | None = None) -> None:
    """Refuse a simulation that needs more memory than there is, or more than a year.

    Parameters
    ----------
    scenario
        What would be simulated.
    memory
        Of the machine that simulates [byte]; ``None``: this one's. ``math.inf`` where that is
        another one, which refuses for itself.

    Raises
    ------
    InputError
        Names the key that is to blame, and what to do.
    """
    # By the time on a fast machine, so that what runs on one machine is refused on none.
    expected = _of_one(scenario, max(SLOWER))
    memory = machine_bytes() if memory is None else memory
    if expected.bytes > memory:
        what, remedy = _largest(_sizes(scenario))
        raise InputError(
            f"{what}: it would take {_size(expected.bytes)} of memory, and this machine has "
            f"{_size(memory)}; {remedy}"
        )
    if expected.longest_seconds > YEAR:
        what, remedy = _largest(_lengths(scenario))
        raise InputError(f"{what}: it would take {lasting(expected.longest_seconds)}; {remedy}")


def refuse_too_many(expected: Forecast, workers: int, source: str) -> None:
    """Refuse cases that together need more memory than this machine has, or more than a year.

    Parameters
    ----------
    expected
        Forecast for all of them.
    workers
        Number of cases that run at the same time.
    source
        File or name of the plan, for the message.

    Raises
    ------
    InputError
        Says how many cases or workers are too many.
    """
    memory = machine_bytes()
    if expected.memory(workers) > memory:
        raise InputError(
            f"{source}: {min(workers, expected.simulations)} simulations at a time would take "
            f"{_size(expected.memory(workers))} of memory, and this machine has "
            f"{_size(memory)}; give --workers {max(1, int(memory // expected.bytes))}"
        )
    refuse_too_long(expected, workers, source)


def refuse_too_long(expected: Forecast, workers: int, source: str) -> None:
    """Refuse cases that together need more than a year; as :func:`refuse_too_many`."""
    if expected.seconds(workers) > YEAR:
        raise InputError(
            f"{source}: {expected.simulations:,} cases would take "
            f"{lasting(expected.seconds(workers))} on {_cores(workers)}; drop some, coarsen the "
            "grid or raise numerics.speed_up"
        )


def machine_bytes() -> float:
    """Memory that this process may use at most [byte]."""
    whole = float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    try:  # of a container
        return min(whole, float(Path("/sys/fs/cgroup/memory.max").read_text()))
    except (OSError, ValueError):
        return whole


def lasting(seconds: float) -> str:
    """A time in words, in a unit that suits its size, such as ``"about 25 minutes"``."""
    if not seconds < 1e4 * YEAR:
        return "over 10,000 years"
    if seconds < 1.0:
        return "less than a second"
    size, unit = next((size, unit) for size, unit in _UNITS if seconds >= 2.0 * size)
    return f"about {seconds / (size or 1.0):,.0f} {unit}"


def particle_count(scenario: Scenario) -> float:
    """Particles of the bed, those where the leg starts included, which will be left out."""
    bed, numerics = scenario.bed, scenario.numerics
    side = numerics.cell_size / numerics.particles_per_cell_side
    left, right = bed.soil_span
    across = (
        scenario.cells_across * numerics.particles_per_cell_side if scenario.cells_across else 1
    )
    return float(round((right - left) / side)) * float(round(bed.height / side)) * float(across)


def step_count(scenario: Scenario) -> float:
    """Steps that cover the motion; may be infinite."""
    steps = scenario.motion.duration / scenario.numerics.speed_up / scenario.numerics.time_step
    return float(math.ceil(steps - 1e-9)) if math.isfinite(steps) else math.inf


def _of_one(scenario: Scenario, register_bits: int) -> Forecast:
    bins = float(bin_count(scenario.motion))
    if scenario.model == "rft":
        seconds = bins * scenario.rft.panels / ELEMENT_POSES_PER_SECOND
        return Forecast(1, 0.0, 0.0, seconds, seconds, sum(_memory(scenario).values()))
    particles = particle_count(scenario)
    work = particles * step_count(scenario)
    in_space = scenario.dimensions == 3
    rate = PARTICLE_STEPS_PER_SECOND_IN_SPACE if in_space else PARTICLE_STEPS_PER_SECOND
    seconds = work / rate * SLOWER[register_bits]
    return Forecast(1, particles, work, seconds, seconds, sum(_memory(scenario).values()))


def _memory(scenario: Scenario) -> dict[str, float]:
    """Memory for the process itself, for particles and grid, and for the history [byte]."""
    bins = BYTES["bin"] * bin_count(scenario.motion)
    rest = BYTES_AT_REST[scenario.model]
    if scenario.model == "rft":
        return {"rest": rest, "bin": bins}
    nodes = float((scenario.numerics.cells + 2) ** 2)
    sizes = BYTES
    if scenario.dimensions == 3:
        sizes, nodes = BYTES_IN_SPACE, nodes * (scenario.cells_across + 2)
    return {
        "rest": rest,
        "particle": sizes["particle"] * particle_count(scenario) + sizes["node"] * nodes,
        "bin": bins,
    }


Blame = tuple[str, str]
"""The key that makes a simulation too large, with its value, and what to do about it."""


def _sizes(scenario: Scenario) -> dict[Blame, float]:
    """Memory that each key is to blame for [byte]."""
    memory, numerics = _memory(scenario), scenario.numerics
    fine = f"{numerics.cells} and numerics.particles_per_cell_side = "
    return {
        _long_path(scenario): memory["bin"],
        (
            f"numerics.cells = {fine}{numerics.particles_per_cell_side}",
            "lower them",
        ): memory.get("particle", 0.0),
    }


def _lengths(scenario: Scenario) -> dict[Blame, float]:
    """How many times more time each key takes than in the paper's benchmark [-]."""
    motion, numerics, bins = scenario.motion, scenario.numerics, bin_count(scenario.motion)
    found = {_long_path(scenario): bins / 2700.0}
    if scenario.model == "mpm":
        step, limit = numerics.time_step, scenario.time_step_limit
        slow = motion.duration / numerics.speed_up / limit / bins
        if motion.kind == "rotation":
            key = "rate" if motion.rate_profile is None else "rate_profile, whose largest"
            rate = f"motion.{key} = {motion.top_coordinate_rate:g} rad/s"
        else:
            rate = f"motion.velocity = {list(motion.velocity)} m/s"
        found |= {
            (f"numerics.time_step = {step:g} s", f"{limit:.2g} s is stable, too"): limit / step,
            (rate, "raise it, or numerics.speed_up"): slow / 1000.0,
            (f"numerics.cells = {numerics.cells}", "lower it"): particle_count(scenario) / 4e4,
        }
    return found


def _long_path(scenario: Scenario) -> Blame:
    """The motion's length, in bins of the history."""
    motion = scenario.motion
    many = f"{float(bin_count(motion)):.2g} bins of the history"
    if motion.kind == "rotation":
        ends = f"motion.start_deg = {motion.start_deg:g}, motion.stop_deg = {motion.stop_deg:g}"
        return f"{ends} make {many}", "turn less far"
    span = f"motion.distance = {motion.distance:g} m, motion.bin_width = {motion.bin_width:g} m"
    return f"{span} make {many}", "move less far, or in wider bins"


def _largest(found: dict[Blame, float]) -> Blame:
    return max(found, key=lambda blame: found[blame])


def _cores(count: int) -> str:
    return "1 core" if count == 1 else f"{count} cores"


def _size(count: float) -> str:
    """Memory in words."""
    gigabytes = count / 1e9
    return f"{gigabytes:,.0f} GB" if gigabytes >= 10.0 else f"{gigabytes:.1f} GB"

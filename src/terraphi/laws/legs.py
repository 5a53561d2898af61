r"""Law ``legs``: forces on a leg of any proportions, from simulations at random ratios.

With D the depth that a leg reaches in level soil, F is compared with ρ g w D²:

    F(θ) = ρ g w D² exp(y_0) [z_0(s) + Σ_k y_k u_k(s)],    s = (2θ − θ_1 − θ_2) / (θ_2 − θ_1),

θ_1 and θ_2 the first and last angle at which the leg reaches into level soil, z_0 and u_k mean and
principal components of the curves over their root mean square. The size y_0 and the weights y_k
share a Gaussian process (:mod:`~terraphi.laws.gp`) over

    ½ ln K,  μ,  ln w/L,  h/L,  ln t/L,  ln(1 + 40 c/(K ρ g D)),  Δx over the rule's

and the curvature, which is 1 of a C, 0 of a straight and −1 of a reversed C leg, so that each shape
learns from the others what friction, cohesion and cells do. K = tan²(45° + φ/2) is the coefficient
of passive earth pressure: the larger it is, the less cohesion adds to the weight of the soil that
is pushed (2 c √K to ½ ρ g D K for a smooth wall). The form of these coordinates (μ or ln μ, the
factor 5 to 40, K to a power of 0 to 1) is the one with the largest restricted likelihood of the
cases. The means are linear in the coordinates and quadratic in the first. With correlation lengths
of its own for each weight, nine times as many, the law predicts cases that are left out as well,
but φ of new ones worse (1.2 instead of 0.8°, root mean square). The law is read in cells of a fifth
of the width or an eleventh of the depth (:func:`cells_of`).

``studies/legs.py`` simulates the cases and finds correlation lengths and nugget.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.documents import shipped_file, strictly
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import (
    CELLS_ACROSS,
    CELLS_DEEP,
    SIMULATED_LENGTH,
    STOP_DEG,
    Ratios,
    Rig,
    leg_of,
    swept,
)
from terraphi.experiment.units import GRAVITY
from terraphi.laws.fitted import FittedLaw
from terraphi.laws.gp import Process
from terraphi.laws.law import AnyLaw, LegLaw, is_similar, remedy
from terraphi.laws.model_error import ModelError
from terraphi.laws.theory import Theory

if TYPE_CHECKING:
    from terraphi.experiment.scenario import Scenario
    from terraphi.laws.store import Library

NAME = "legs"
FORMER_NAME = "sand3d"
"""Name of an earlier law, of the rig of Li et al. (2013) alone, which means this one now."""
VARIED = {
    "soil.cohesion", "leg.chord", "leg.width", "leg.half_thickness", "leg.friction",
    "motion.hip.0", "motion.hip.1", "motion.start_deg", "motion.stop_deg", "bed.left", "bed.floor",
    "bed.width", "bed.height", "bed.breadth", "numerics.domain", "numerics.cells",
    "numerics.time_step", "numerics.remap_interval",
}  # fmt: skip
"""Scenario keys in which the cases differ, besides those that :func:`differences` ignores."""
DENSITY = 1650.0
"""Bulk density of the simulated soil [kg/m³]; forces are in proportion to it."""
AXES = ("phi_deg", "mu", "width", "hip_height", "thickness", "cohesion", "cells", "curvature")
"""Parameters of a case: φ [deg], friction of the leg [-], ratios to its length [-], c/(ρ g L) [-],
the size of the cell over that of the rule [-], and the curvature of the leg."""
PLACES = np.linspace(-1.12, 1.12, 113)
"""Places s of the curves; beyond them there is no force."""
FADES = 0.06
"""Part of the places over which forces fade out at either end [-]; chosen."""
MODES = 8
"""Principal components that are kept: the next adds less than a tenth of the first (chosen)."""
NEAR_RULE = 1.3
"""Size of the cells over that of the rule below which cases scatter as in the rule's [-]; chosen: a
quarter of the cases."""
ROUGHER = 0.75
"""Power of the size of the cells with which the scatter of simulations grows [-]: of 0, 0.5, 0.75,
1, 2 and 3 the likeliest."""
FRICTIONS = (0.1, 0.6)
"""Frictions of a leg that the law is for [-]: those that were simulated."""
SHIFTED_DEG = np.arange(-105.0, 101.0)
"""Leg angles of the law [deg]: those of records, and what a shift brings there."""
PHI_DEG = (10.0, 55.0)
"""Smallest and largest friction angle of the design [deg]."""
MOST_COHESION = 0.4
"""Largest c / (ρ g L) that is averaged over [-]; cases go to 0.37 (straight) and 0.47 (C legs)."""


@functools.lru_cache(maxsize=256)
def reach(leg: str, ratios: Ratios) -> tuple[float, float, float]:
    """First and last angle in level soil [deg], and the greatest depth over the length [-].

    In soil is what reaches half a thickness deep, which the end at a low hip does not.
    """
    # Lowest point of the leg over the level at which contact counts, by whole degrees [m].
    theta = np.arange(-260.0, 201.0)
    body = leg_of(leg, ratios, SIMULATED_LENGTH)
    low = swept(body, ratios.hip_height * SIMULATED_LENGTH, theta)[..., 1].min(axis=1)
    low += body.half_thickness + 1e-9
    # The stroke is the contact around the deepest angle. It begins and ends where that height
    # passes zero, linear within a degree.
    deepest, air = int(low.argmin()), np.flatnonzero(low >= 0.0)
    before, after = air[air < deepest][-1], air[air > deepest][0]
    begins = np.interp(0.0, -low[before : before + 2], theta[before : before + 2])
    ends = np.interp(0.0, low[after - 1 : after + 1], theta[after - 1 : after + 1])
    depth = body.half_thickness - low[deepest]
    return float(begins), float(ends), float(depth / SIMULATED_LENGTH)


def places_deg(leg: str, ratios: Ratios) -> FloatArray:
    """Leg angles of :data:`PLACES` [deg]."""
    first, last, _ = reach(leg, ratios)
    return 0.5 * (first + last + (last - first) * PLACES)


def unit_of_force(density: float, length: float, ratios: Ratios, depth: float) -> float:
    """ρ g w D² [N] of a leg of a length [m] that reaches D / L deep."""
    return density * GRAVITY * length**3 * ratios.width * depth**2


def cells_of(ratios: Ratios, depth: float) -> float:
    """Size of the rule's cell over the length of the leg [-], at a depth over it [-]."""
    return min(ratios.width / CELLS_ACROSS, depth / CELLS_DEEP)


@dataclass(frozen=True, eq=False, repr=False)
class Legs(AnyLaw, FittedLaw):
    """The law of all legs that there are cases of.

    Forces are over ρ g w D², the depth D of a case over the length L. Hyperparameters are one
    correlation length for each axis, over its standard deviation, and a nugget.

    Attributes
    ----------
    name, caveat
        Of the library of one's own that was joined to it.
    joined_rigs
        Rigs of that library, a rig for each of its cases, which are the last.
    """

    AXES = AXES
    PLACES = PLACES
    HYPER = (1, len(AXES) + 1)
    PRESET = "sand3d"
    convention, phi_deg = "plane_strain", PHI_DEG

    name: str = NAME
    caveat: str = ""
    joined_rigs: tuple[Rig, ...] = ()

    @property
    def _design(self) -> slice:
        """The cases that scales and components are of."""
        return slice(len(self.x) - len(self.joined_rigs))

    # -- the process -----------------------------------------------------------------------------

    def _coordinates(self, x: FloatArray, depth: FloatArray) -> FloatArray:
        """Coordinates in which the process is smooth, shape [k, axis]."""
        phi, mu, width, height, thickness, cohesion, cells, curvature = x.T
        # ln √K in place of φ, for forces grow with φ much as passive earth pressure does. Cohesion
        # counts over the weight of the soil that is pushed: c / (K ρ g D), with D = depth L.
        passive = np.square(np.tan(np.radians(45.0 + 0.5 * phi)))
        damp = np.log1p(40.0 * cohesion / (passive * depth))
        return np.stack([
            0.5 * np.log(passive), mu, np.log(width), height, np.log(thickness), damp, cells,
            curvature,
        ], axis=1)  # fmt: skip

    @cached_property
    def _scale(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of the coordinates of the cases, shape [axis] each."""
        t = self._coordinates(self.x, self.depth)[self._design]
        return t.mean(axis=0), np.maximum(t.std(axis=0), 1e-9)

    def _standard(self, x: FloatArray, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Standardized coordinates [k, axis], and polynomials of the mean [k, q]."""
        t = (self._coordinates(x, depth) - self._scale[0]) / self._scale[1]
        # A coordinate that is the same in all cases would repeat the constant of the mean.
        varied = np.ptp(self.x[self._design], axis=0) > 0.0
        return t, np.hstack([np.ones((len(t), 1)), t[:, varied], t[:, :1] ** 2])

    @cached_property
    def _components(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """z_0 [2 place], u [k, 2 place] and y of the cases [case, 1 + k]."""
        # A curve is its size times its shape z. Components are the right singular vectors of the
        # shapes less their mean, those of the design alone: a joined library does not turn them.
        flat = self.force.reshape(len(self.x), -1)
        size = np.sqrt(np.square(flat).mean(axis=1))
        z = flat / size[:, None]
        mean = z[self._design].mean(axis=0)
        u = np.linalg.svd(z[self._design] - mean, full_matrices=False)[2][:MODES]
        return mean, u, np.column_stack([np.log(size), (z - mean) @ u.T])

    @property
    def training(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Coordinates, polynomials, size and weights of the cases, and roughness, [case, …]."""
        rough = self.x[:, AXES.index("cells")] ** ROUGHER
        return *self._standard(self.x, self.depth), self._components[2], rough

    @cached_property
    def process(self) -> Process:
        """Process of the size and the weights."""
        t, basis, y, rough = self.training
        return Process.of(t, basis, y, self.hyper[0, :-1], float(self.hyper[0, -1]), rough)

    def __call__(self, x: FloatArray, depth: FloatArray) -> FloatArray:
        """Forces over ρ g w D² [-], shape [k, axis], [k] -> [k, 2, place]."""
        mean, u, _ = self._components
        y = self.process.mean(*self._standard(x, depth))
        return (np.exp(y[:, :1]) * (mean + y[:, 1:] @ u)).reshape(len(x), 2, -1)

    def errors(self, x: FloatArray, depth: FloatArray) -> FloatArray:
        """Forces of one standard deviation of each weight [-], [mode, k, 2, place]."""
        # To first order δF = F δy_0 + exp(y_0) Σ u_k δy_k; the errors of the y are independent.
        at = self._standard(x, depth)
        sd = self.error_scale * np.sqrt(self.process.variance(*at)).T
        force, u = self(x, depth), self._components[1].reshape(MODES, 2, -1)
        size = np.exp(self.process.mean(*at)[:, 0])
        return np.stack([
            sd[0][:, None, None] * force,
            *((size * a)[:, None, None] * mode for a, mode in zip(sd[1:], u, strict=True)),
        ])  # fmt: skip

    def scatter(self, x: FloatArray, depth: FloatArray) -> FloatArray:
        """Factor of the covariance of a simulation about the law's mean [-], [k, 2, place].

        By its particle seed, as the nugget has it, and by the shape that the components lack, as
        the cases in cells near those of the rule have it.
        """
        mean, u, y = self._components
        # What the components leave of each case, over its size; coarse cells scatter more.
        size = np.sqrt(np.square(self.force).mean(axis=(1, 2)))
        unexplained = self.force.reshape(len(y), -1) / size[:, None] - mean - y[:, 1:] @ u
        unexplained = unexplained[self.x[:, AXES.index("cells")] < NEAR_RULE]
        force = self(x, depth)[0].ravel()
        sd = x[0, AXES.index("cells")] ** ROUGHER * np.sqrt(self.process.nugget)
        rms = float(np.sqrt(np.square(force).mean()))
        # Rows: the seed's change of the size, of each weight, and each case's unexplained shape.
        rows = [
            sd[:1] * force[None],
            rms * sd[1:, None] * u,
            rms / np.sqrt(len(unexplained)) * unexplained,
        ]
        return np.vstack(rows).reshape(-1, *self.force.shape[1:])

    # -- contents and file -----------------------------------------------------------------------

    def of(self, leg: str) -> NDArray[np.bool_]:
        """True for cases of a shape of leg, shape [case]."""
        return np.asarray(self.x[:, AXES.index("curvature")] == OUTLINES[leg].curvature)

    @property
    def legs(self) -> list[str]:
        """Shapes of its legs, sorted."""
        return sorted(leg for leg in OUTLINES if self.of(leg).any())

    def ranges(self, leg: str) -> dict[str, tuple[float, float]]:
        """Smallest and largest value of each axis among the design's cases of a shape."""
        columns = zip(AXES, self.x[self._design][self.of(leg)[self._design]].T, strict=True)
        return {axis: (float(column.min()), float(column.max())) for axis, column in columns}

    def summary(self) -> dict[str, Any]:
        """Contents and origin, JSON-able; the range of φ is that of the law, not of its cases."""
        ranges = {leg: self.ranges(leg) | {"phi_deg": self.phi_deg} for leg in self.legs}
        return super().summary() | {"cases": len(self.x), "ranges": ranges}

    def to_netcdf(self, path: Path | str) -> None:
        """Write one NetCDF-4 file; raises InputError if the place cannot be written.

        A library that was joined stays in its own file.
        """
        if self.joined_rigs:
            raise InputError(f"law legs with library {self.name}: keep the library's own file")
        super().to_netcdf(path)

    save = to_netcdf

    def joined(self, library: Library) -> Legs:
        """The law with the cases of a library, of rigs of its own, among its own."""
        x, depth, force, rigs = cases_of(library)
        return replace(
            self,
            x=np.vstack([self.x, x]), depth=np.append(self.depth, depth),
            force=np.concatenate([self.force, force]),
            name=library.name, caveat=library.caveat, joined_rigs=rigs,
            provenance=self.provenance | {"joined": dict(library.provenance)},
        )  # fmt: skip

    @cached_property
    def error(self) -> ModelError:
        """How real soils differ from the law.

        Raises InputError if the file has none of this form.
        """
        if self.model_error and NAME not in self.model_error:
            raise InputError(
                f"law {self.name}: its error is of another version of terraphi; make it again"
            )
        return strictly(self.model_error.get(NAME, {}), ModelError, f"law {self.name}, model_error")

    def law(self, rig: Rig, cells: float = 1.0) -> LegLaw:
        """The law of a rig, in cells of a size over that of the rule [-].

        Raises
        ------
        InputError
            If there is no such leg, or a ratio of the rig lies outside the cases.
        """
        least, most = FRICTIONS
        if not least <= rig.leg_friction <= most:
            friction = rig.leg_friction
            raise InputError(f"leg_friction = {friction:g}; {least:g} to {most:g} are accepted")
        if any(rig.leg == joined.leg and is_similar(rig, joined) for joined in self.joined_rigs):
            return RatioLaw(self, rig, cells)
        if rig.leg not in self.legs:
            raise InputError(f"law {NAME} has no {OUTLINES[rig.leg].label} yet; {remedy(rig)}")
        ranges = self.ranges(rig.leg)
        low, high = ranges["cells"]
        if not low <= cells <= high:
            rule = f"cells of {low:.2g} to {high:.2g} times those of its rule"
            raise InputError(f"law {NAME} is for {rule}, and the simulation has {cells:.2g}")
        for name, value in rig.ratios._asdict().items():
            low, high = ranges[name]
            if not low <= value <= high:
                ratio = f"{name.replace('_', ' ')} over length from {low:.3g} to {high:.3g}"
                raise InputError(f"law {NAME} is for {ratio}, not {value:.4g}; {remedy(rig)}")
        return RatioLaw(self, rig, cells)


class RatioLaw(LegLaw):
    """The law of a rig."""

    density = DENSITY
    most_cohesion = MOST_COHESION

    def __init__(self, law: Legs, rig: Rig, cells: float = 1.0) -> None:
        self._law, self._rig, self._cells, self.theta_deg = law, rig, cells, SHIFTED_DEG
        self.bounds = np.array(PHI_DEG[:1]), np.array(PHI_DEG[1:])
        self.leg_friction = rig.leg_friction

    @cached_property
    def arm(self) -> FloatArray:
        """Lever arms of resistive force theory: where on the leg the soil presses."""
        law = Theory().law(self._rig)
        return np.stack([np.interp(self.theta_deg, law.theta_deg, row) for row in law.arm])

    def _at(
        self, phi_deg: FloatArray, cohesion: float, rougher: float = 0.0, higher: float = 0.0
    ) -> tuple[FloatArray, FloatArray, Callable[[FloatArray], FloatArray]]:
        """Parameters [k, axis], depths [k], and what turns curves over places into forces [N].

        With more friction of the leg, and with the hip higher by a part of the length.
        """
        rig, ratios = self._rig, self._rig.ratios
        ratios = ratios._replace(hip_height=ratios.hip_height + higher)
        first, last, depth = reach(rig.leg, ratios)
        mu = rig.leg_friction + rougher
        row = [0.0, mu, ratios.width, ratios.hip_height, ratios.thickness, cohesion,
               self._cells, OUTLINES[rig.leg].curvature]  # fmt: skip
        x = np.tile(row, (len(phi_deg), 1))
        x[:, 0] = phi_deg
        # From places s to leg angles θ, linear between places.
        s = (2.0 * self.theta_deg - first - last) / (last - first)
        i = np.clip(np.searchsorted(PLACES, s) - 1, 0, PLACES.size - 2)
        share = (s - PLACES[i]) / (PLACES[i + 1] - PLACES[i])
        size = unit_of_force(DENSITY, rig.length, ratios, depth)
        # What little force there is at the last place fades out there.
        weights = size * np.clip((PLACES[-1] - np.abs(s)) / FADES, 0.0, 1.0)

        def forces(curves: FloatArray) -> FloatArray:
            between = (1.0 - share) * curves[..., i] + share * curves[..., i + 1]
            return np.asarray(weights * between)

        return x, np.full(len(x), depth), forces

    def within(self, x: FloatArray, cohesion: float, **changed: float) -> FloatArray:
        """Forces within the bounds; of a changed rig as in :meth:`_at`."""
        parameters, depth, forces = self._at(x[:, 0], cohesion, **changed)
        return forces(self._law(parameters, depth))

    def errors(self, x: FloatArray, cohesion: float, *, is_measured: bool) -> dict[str, FloatArray]:
        """The Gaussian process, and of measured forces one standard deviation of friction and hip.

        Of simulated ones the scatter of a simulation about the law's mean.
        """
        at, depth, forces = self._at(np.clip(x, *self.bounds), cohesion)
        rows = {"emulator": forces(self._law.errors(at, depth))[:, 0]}
        if not is_measured:
            rows["particle scatter"] = forces(self._law.scatter(at, depth))
        factors = {name: row.reshape(len(row), -1).T for name, row in rows.items()}
        if is_measured:
            rig = self._rig
            rougher = self._slope(x, cohesion, "rougher", -0.05, 0.05)
            higher = self.of_hip(x, cohesion)
            factors["leg friction"] = rig.leg_friction_sd * rougher
            factors["hip height"] = rig.hip_height_sd_mm * higher
        return factors

    def _slope(
        self, x: FloatArray, cohesion: float, cause: str, below: float, above: float
    ) -> FloatArray:
        """Change of the forces with ``rougher`` or ``higher`` of a rig, shape [2 theta, 1]."""
        phi = np.clip(x, *self.bounds)[:, None]
        ends = [self.within(phi, cohesion, **{cause: step}) for step in (below, above)]
        return np.asarray((ends[1] - ends[0]).reshape(-1, 1) / (above - below))

    def of_hip(self, x: FloatArray, cohesion: float) -> FloatArray:
        """Change of the forces with the height of the hip [N/mm], shape [2 theta, 1]."""
        # Central differences, but that a hip cannot be below the soil.
        below = -min(0.02, self._rig.ratios.hip_height)
        return self._slope(x, cohesion, "higher", below, 0.02) / self._rig.length_mm


def cells_in(scenario: Scenario | None, rig: Rig) -> float:
    """Size of a simulation's cells over that of the rule for its rig [-]; 1 of measured forces.

    Raises InputError if it is not a material point method in three dimensions.
    """
    if scenario is None:
        return 1.0
    if (scenario.model, scenario.dimensions) != ("mpm", 3):
        other = f"{scenario.dimensions} dimensions by {scenario.model}"
        raise InputError(f"law {NAME} is of 3 dimensions by mpm, not of {other}; leave it out")
    depth = reach(rig.leg, rig.ratios)[2]
    return scenario.numerics.cell_size / rig.length / cells_of(rig.ratios, depth)


LawOfLegs: TypeAlias = Legs | Theory
"""A law of legs."""
Cases = tuple[FloatArray, FloatArray, FloatArray, tuple[Rig, ...]]


def law_of(law: LawOfLegs, rig: Rig, scenario: Scenario | None) -> LegLaw:
    """The law of a rig, of a simulation in its cells; raises InputError if it covers neither."""
    return law.law(rig, cells_in(scenario, rig)) if isinstance(law, Legs) else law.law(rig)


def cases_of(library: Library) -> Cases:
    """Cases of a library: `x`, `depth` and `force` of a law, and the rig of each.

    Raises
    ------
    InputError
        If one is not of a leg that turns in three dimensions, from air to air.
    """
    x, depths, forces, rigs = [], [], [], []
    for scenario, history, _ in library.cases:
        rig = Rig.of_scenario(scenario)
        if (scenario.model, scenario.dimensions) != ("mpm", 3) or rig is None:
            raise InputError(f"library {library.name} is not of legs that turn in three dimensions")
        if history is None:
            continue
        ratios, soil = rig.ratios, scenario.soil
        first, last, depth = reach(rig.leg, ratios)
        begins, ends = history.theta_deg[[0, -1]]
        # Presets end at 90°, where a reversed C is about to leave the soil.
        if begins > first + 1.0 or ends < min(last, STOP_DEG) - 1.0:
            raise InputError(f"library {library.name}: its legs do not turn from air to air")
        at = np.radians(places_deg(rig.leg, ratios))
        size = unit_of_force(soil.density, rig.length, ratios, depth)
        cohesion = soil.cohesion / (soil.density * GRAVITY * rig.length)
        x.append([soil.friction_angle_deg, scenario.leg.friction, *ratios, cohesion,
                  cells_in(scenario, rig), OUTLINES[rig.leg].curvature])  # fmt: skip
        depths.append(depth)
        # Means over 1° about each place. Beyond the path there is no force.
        means = history.means(np.clip(at, *history.position[[0, -1]]), np.radians(0.5))
        inside = (history.position[0] <= at) & (at <= history.position[-1])
        forces.append(np.where(inside[:, None], means, 0.0).T / size)
        rigs.append(rig)
    return np.array(x), np.array(depths), np.array(forces), tuple(rigs)


@functools.cache
def shipped_legs() -> Legs:
    """The shipped law, kept for the next record."""
    return Legs.load(shipped_file("laws", NAME, ".nc"))

"""The friction angle of a soil, and how sure of it we are, from the forces on a leg in it.

The public names are loaded when first used, so that ``import terraphi`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from terraphi.experiment.solvers import SOLVERS

if TYPE_CHECKING:
    from terraphi.experiment.errors import InputError as InputError
    from terraphi.experiment.errors import SimulationError as SimulationError
    from terraphi.experiment.history import ForceHistory as ForceHistory
    from terraphi.experiment.leg import Leg as Leg
    from terraphi.experiment.measurements import measurement as measurement
    from terraphi.experiment.motion import Rotation as Rotation
    from terraphi.experiment.motion import Translation as Translation
    from terraphi.experiment.reading import read_forces as read_forces
    from terraphi.experiment.rig import Rig as Rig
    from terraphi.experiment.scenario import Scenario as Scenario
    from terraphi.experiment.soil import Soil as Soil
    from terraphi.forward import simulate as simulate
    from terraphi.forward.driver import Solver
    from terraphi.inference.answer import Answer as Answer
    from terraphi.inference.calibration import calibrate as calibrate
    from terraphi.inference.inversion import invert as invert
    from terraphi.inference.inversion import invert_many as invert_many
    from terraphi.inference.next_measurement import next_measurements as next_measurements
    from terraphi.inference.next_measurement import plan as plan
    from terraphi.inference.rolled import phi_along as phi_along
    from terraphi.laws.build import build as build
    from terraphi.laws.named import law_named as law  # noqa: F401
    from terraphi.laws.plan import Plan as Plan
    from terraphi.laws.store import Library as Library
    from terraphi.robot.footfalls import footfalls as footfalls
    from terraphi.robot.footfalls import footfalls_many as footfalls_many
    from terraphi.robot.joint_log import JointLog as JointLog
    from terraphi.robot.logs.messages import Messages as Messages
    from terraphi.robot.online import Footfalls as Footfalls
    from terraphi.robot.results import foot_forces as foot_forces
    from terraphi.terrain.export import export as export
    from terraphi.terrain.layers import write as layers  # noqa: F401
    from terraphi.terrain.map import map_slopes as map  # noqa: A004, F401
    from terraphi.terrain.simulators import convert as convert
    from terraphi.terrain.soils import soil as soil
    from terraphi.terrain.tune import tune as tune
    from terraphi.view.page import report as report

_PLACES = {
    "Answer": "inference.answer",
    "Footfalls": "robot.online",
    "ForceHistory": "experiment.history",
    "InputError": "experiment.errors",
    "JointLog": "robot.joint_log",
    "Leg": "experiment.leg",
    "Library": "laws.store",
    "Messages": "robot.logs.messages",
    "Plan": "laws.plan",
    "Rig": "experiment.rig",
    "Rotation": "experiment.motion",
    "Scenario": "experiment.scenario",
    "SimulationError": "experiment.errors",
    "Soil": "experiment.soil",
    "Translation": "experiment.motion",
    "build": "laws.build",
    "calibrate": "inference.calibration",
    "convert": "terrain.simulators",
    "export": "terrain.export",
    "foot_forces": "robot.results",
    "footfalls": "robot.footfalls",
    "footfalls_many": "robot.footfalls",
    "invert": "inference.inversion",
    "invert_many": "inference.inversion",
    "next_measurements": "inference.next_measurement",
    "phi_along": "inference.rolled",
    "plan": "inference.next_measurement",
    "law": "laws.named:law_named",
    "layers": "terrain.layers:write",
    "map": "terrain.map:map_slopes",
    "measurement": "experiment.measurements",
    "read_forces": "experiment.reading",
    "report": "view.page",
    "simulate": "forward",
    "soil": "terrain.soils",
    "tune": "terrain.tune",
}
"""Public name to its module, and to its name there if that is another."""

__all__ = [name for name in _PLACES if name != "map"]  # which Python has itself


def _plane_strain(scenario: Scenario) -> Solver:
    """The solver of Xu & Wang; only this and ``terraphi paper`` import from ``paper/``."""
    from terraphi.paper.plane.solver import PlaneSolver

    return PlaneSolver(scenario)


SOLVERS[2] = _plane_strain


def __getattr__(name: str) -> Any:
    """Load a public name, or the version."""
    if name == "__version__":
        from importlib.metadata import version

        return version("terraphi")
    if name not in _PLACES:
        raise AttributeError(f"module 'terraphi' has no attribute '{name}'")
    module, _, there = _PLACES[name].partition(":")
    return getattr(importlib.import_module(f"terraphi.{module}"), there or name)


def __dir__() -> list[str]:
    """Public names."""
    return sorted(_PLACES)

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

__version__: str

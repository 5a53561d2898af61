r"""What soils of known angle tell of another: a calibration, and a check without a library.

**Calibration.** A soil i of known angle k_i +- s_i came out at f_i +- e_i. With an offset o and a
slope b of the library, and a level of its own,

    k_i - f_i = o + b (f_i - f_0) + level_i + error_i,

o ~ N(0, tau_o^2), b ~ N(0, SLOPE^2) from two soils on (before that it is zero), level_i ~
N(0, tau^2), tau the spread between soils. Offset and slope are normal given the soils (Bayesian
linear regression), shrunk by the spread: a library whose offset is known already, by tau_o,
hardly learns from one soil. A new soil at f then has the level

    N(o + b (f - f_0), tau^2 + x^T S x),    x = (1, f - f_0), S the covariance of o and b.

**The check.** In one apparatus the forces of a soil over its density rise with its angle. A line

    phi = a + c ln(RMS force / density)

through the shipped media that have an angle of repose foretells that of another to CHECK_DEG. Two
or three media hardly fix c; forces rise by some 5 % a degree in all models, so c has a prior.
"""

from __future__ import annotations

import functools
import importlib.metadata
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import Strict
from terraphi.experiment.errors import InputError, sentence_from_validation
from terraphi.experiment.files import number_with_sd, replacing
from terraphi.experiment.measurements import (
    is_of_their_apparatus,
    measurement,
    medium_and_leg,
    names,
)
from terraphi.experiment.scenario import Scenario
from terraphi.inference.discrepancy import FREEDOM, SPREAD_DEG, Learnt, Level
from terraphi.inference.words import of_verdict
from terraphi.library.store import Library

if TYPE_CHECKING:
    from terraphi.inference.answer import Inversion


OFFSET_DEG = 10.0
"""Standard deviation of a library's offset before soils are seen [deg]."""
SLOPE = 0.25
"""Standard deviation of its slope [deg/deg]."""
CHECK_DEG = 2.1
"""Standard deviation of an angle foretold by the line [deg]: of eight media in one apparatus."""
RISE_DEG, RISE_SD_DEG = 20.0, 7.0
"""Prior of c, and its standard deviation [deg]: forces rise by 4 to 8 % a degree."""


class KnownSoil(Strict):
    """A soil of known friction angle, and what came out of its forces."""

    phi_deg: float = Field(gt=0.0, lt=90.0)
    sd_deg: float = Field(gt=0.0)
    found_deg: float = Field(gt=0.0, lt=90.0)
    found_sd_deg: float = Field(ge=0.0)
    legs: tuple[str, ...]
    forces: tuple[str, ...]
    medium: str = ""


class Calibration(Strict):
    """A library compared with soils of known friction angle, as its file has it."""

    kind: Literal["terraphi calibration on known soils"] = "terraphi calibration on known soils"
    version: str = ""
    library: str
    library_hash: str
    soils: tuple[KnownSoil, ...] = Field(min_length=1)

    @classmethod
    def of(cls, library: Library, soils: Sequence[KnownSoil]) -> Calibration:
        """Of a library, by soils."""
        return cls(
            version=importlib.metadata.version("terraphi"),
            library=library.name,
            library_hash=library.hash,
            soils=tuple(soils),
        )

    @classmethod
    def load(cls, path: Path | str) -> Calibration:
        """Read a file; InputError if it is none."""
        try:
            return cls.model_validate_json(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from error
        except ValueError as error:
            if isinstance(error, ValidationError) and error.errors()[0]["type"] != "json_invalid":
                raise InputError(sentence_from_validation(error, str(path), cls)) from error
            raise InputError(f"{path}: not a file that 'terraphi calibrate' wrote") from error

    def save(self, path: Path) -> None:
        """Write it, whole or not at all."""
        with replacing(path) as place:
            place.write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")

    def check(self, library: Library) -> None:
        """Refuse another library than that it was made with."""
        if (self.library, self.library_hash) != (library.name, library.hash):
            raise InputError(
                f"the calibration was made with library '{self.library}' "
                f"({self.library_hash[:8]}); this is '{library.name}' ({library.hash[:8]}): "
                f"take --library {self.library}, or calibrate {library.name}"
            )

    def check_legs(self, legs: Iterable[str]) -> None:
        """Refuse a leg that no soil was measured on, where nothing is known of how legs differ."""
        known = {leg for soil in self.soils for leg in soil.legs}
        for leg in set(legs) - known:
            raise InputError(
                f"the calibration has no soil on leg '{leg}', and of library '{self.library}' "
                "nothing is known of how legs differ; calibrate with that leg"
            )

    def with_soil(self, soil: KnownSoil) -> Calibration:
        """The same with one more soil; InputError if it is in it already."""
        for one in self.soils:
            if set(one.forces) & set(soil.forces) or (one.medium and one.medium == soil.medium):
                raise InputError(
                    f"{', '.join(soil.forces)}: a soil of these forces or of this name is in the "
                    "calibration already; give all forces of one soil at once"
                )
        return self.model_copy(update={"soils": (*self.soils, soil)})

    def level(self, found_deg: float, learnt: Learnt | None) -> Level:
        """Level of a soil whose forces give an angle; see the module.

        Parameters
        ----------
        found_deg
            f [deg].
        learnt
            The library's discrepancy, if it has one: how well its offset is known already.
        """
        base = learnt.level if learnt else Level(0.0, {"soils": SPREAD_DEG}, FREEDOM)
        offset_sd = OFFSET_DEG
        if learnt and learnt.levels_deg:
            offset_sd = base.scale_deg / math.sqrt(len(learnt.levels_deg))
        found = np.array([soil.found_deg for soil in self.soils])
        centre = float(found.mean())
        x = np.column_stack([np.ones(len(found)), found - centre])
        y = np.array([soil.phi_deg for soil in self.soils]) - found
        errors = [base.scale_deg**2 + s.sd_deg**2 + s.found_sd_deg**2 for s in self.soils]
        slope_sd = SLOPE if len(found) > 1 else 1e-6
        precision = np.diag([offset_sd**-2, slope_sd**-2]) + (x.T / errors) @ x
        covariance = np.linalg.inv(precision)
        mean = covariance @ ((x.T / errors) @ y)
        at = np.array([1.0, found_deg - centre])
        level = base.wider("calibration", math.sqrt(float(at @ covariance @ at)))
        return replace(level, offset_deg=float(at @ mean))


def known_soil(found: Inversion, phi_deg: float, sd_deg: float, *, medium: str = "") -> KnownSoil:
    """A soil of known angle from the inversion of its forces; InputError if that tells no angle.

    Parameters
    ----------
    found
        Without a calibration.
    phi_deg, sd_deg
        What is known of it [deg].
    medium
        What it is called.
    """
    if found.origin == "simulated":
        raise InputError(f"{found.source}: is simulated; a calibration is for measured forces")
    if found.of_phi is None:
        raise InputError(
            f"library '{found.library}' infers several parameters; a calibration is of φ alone: "
            "take a library of one density"
        )
    verdict = found.verdict
    # A model that is wrong alike for all soils is what a calibration is for.
    alike = verdict.code in ("calibrated_misfit", "calibrated_misfit_at_edge")
    ends = any(one.exceeded for one in verdict.measures if one.code == "edge_density")
    if ends or not (alike or verdict.verdict == "consistent"):
        raise InputError(f"{found.source}: nothing to calibrate with. {of_verdict(verdict)}")
    own = found.provenance["library_angle_deg"]
    return KnownSoil(
        phi_deg=phi_deg,
        sd_deg=sd_deg,
        found_deg=own["median"],
        found_sd_deg=own["sd"],
        legs=tuple(found.by_leg),
        forces=tuple(record.source for record in found.records),
        medium=medium,
    )


MOST_SD_DEG = 15.0
"""Standard deviation beyond which a friction angle is not known at all [deg]."""


def angle_with_sd(text: str) -> tuple[float, float]:
    """``35±2`` or ``35+-2`` as numbers [deg]; InputError if it is neither."""
    try:
        mean, sd = number_with_sd(text)
    except ValueError:
        mean, sd = 0.0, None
    if not 0.0 < mean < 90.0 or sd is None or not sd > 0.0:
        raise InputError(
            f"--phi {text}: expected the friction angle and its standard deviation in degrees, "
            "as 35±2 or 35+-2"
        )
    if sd > MOST_SD_DEG:
        raise InputError(
            f"--phi {text}: an uncertainty of {sd:g} degrees says nothing of the angle; above 0 "
            f"and at most {MOST_SD_DEG:g} is expected"
        )
    return mean, sd


@dataclass(frozen=True)
class Compared:
    """A soil beside known ones, by the size of its forces alone.

    Attributes
    ----------
    low_deg, high_deg
        Ends of the 95 % interval of its friction angle [deg].
    media
        The known ones.
    """

    low_deg: float
    high_deg: float
    media: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and words."""
        return asdict(self)


def compared(
    forces: Sequence[tuple[str, FloatArray, str]], density: float, scenario: Scenario
) -> Compared | None:
    """Compare measured records with the shipped media; ``None`` if the apparatus is another.

    Parameters
    ----------
    forces
        Leg, observation vector [N] and shipped name, or nothing, of each record.
    density
        Of the soil [kg/m³].
    scenario
        What the records are inverted as: legs, and height of the hip.
    """
    if not is_of_their_apparatus(scenario):
        return None
    own = {medium_and_leg(name)[0] for _, _, name in forces if name}
    foretold = [_foretold(shape, _log_size(v, density), own) for shape, v, _ in forces]
    if None in foretold or not foretold:
        return None
    middle, sd = (float(np.mean(part)) for part in zip(*filter(None, foretold), strict=True))
    media = tuple(sorted(set(_known_media()) - own))
    return Compared(middle - 2.0 * sd, middle + 2.0 * sd, media)


def _log_size(vector: FloatArray, density: float) -> float:
    return math.log(math.sqrt(float(np.square(vector).mean())) / density)


@functools.cache
def _known_media() -> dict[str, dict[str, tuple[float, float]]]:
    """Shipped media with an angle of repose: by leg, ln(RMS force / density) and that angle."""
    known: dict[str, dict[str, tuple[float, float]]] = {}
    for name in names():
        one = measurement(name)
        if one.angle_of_repose_deg is not None and one.density_kg_m3 is not None:
            size = _log_size(one.history.observation().vector, one.density_kg_m3)
            medium, leg = medium_and_leg(name)
            known.setdefault(medium, {})[leg] = size, one.angle_of_repose_deg
    return known


def _foretold(leg: str, log_size: float, without: set[str]) -> tuple[float, float] | None:
    """Angle by the line through known media, and its standard deviation [deg]."""
    rows = [by[leg] for m, by in _known_media().items() if m not in without and leg in by]
    if len(rows) < 2:
        return None
    x, y = np.array(rows).T
    centre, apart = float(x.mean()), x - x.mean()
    precision = float(apart @ apart) / CHECK_DEG**2 + 1.0 / RISE_SD_DEG**2
    slope = (float(apart @ y) / CHECK_DEG**2 + RISE_DEG / RISE_SD_DEG**2) / precision
    beyond = log_size - centre
    variance = CHECK_DEG**2 * (1.0 + 1.0 / len(x)) + beyond**2 / precision
    return float(y.mean()) + slope * beyond, math.sqrt(variance)

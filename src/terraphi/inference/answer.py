"""The answer of an inversion: friction angle, interval and verdict, and what they rest on."""

from __future__ import annotations

import copy
import json
import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AliasChoices, ConfigDict, Field

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import write_netcdf
from terraphi.experiment.results import Shown
from terraphi.experiment.rig import Rig, Tool
from terraphi.laws.law import PHI

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from terraphi.inference.bekker import Bekker

log = logging.getLogger(__name__)

SHIFT_DRAWN_DEG = 0.05
"""Shift of θ from which a picture has the curve without it as well [deg]."""
QUANTILES = 4000
"""Equally probable values that stand for a posterior by quadrature where draws are wanted."""


def decimals(ci68: Sequence[float]) -> int:
    """Decimals that an angle [deg] deserves by its interval, as in 34 ± 4 and in 34.1 ± 0.4."""
    half = max(0.5 * (ci68[1] - ci68[0]), 1e-3)
    return min(max(math.ceil(-math.log10(half)), 0), 3)


def quantiles(
    grid: FloatArray, density: FloatArray, share: Sequence[float] | FloatArray
) -> FloatArray:
    """Quantiles of a density on a grid, at probabilities."""
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(grid)
    cumulated = np.concatenate([[0.0], np.cumsum(steps)])
    return np.interp(share, cumulated / cumulated[-1], grid)


BY_LAW = ("law_phi_deg", "offset_deg")
"""Entries of the provenance on one fit to the forces alone."""
STEP_DEG = 0.05
"""Largest step of the grid of a normal posterior [deg]."""
NO_PLANE_STRAIN = "√J₂ = p tan φ has no plane-strain equivalent from φ = 45° on"


@dataclass(frozen=True)
class Estimate:
    """Median, standard deviation and equal-tailed intervals of a parameter, in its unit."""

    median: float
    sd: float
    ci68: tuple[float, float]
    ci95: tuple[float, float]

    @classmethod
    def of_density(cls, grid: FloatArray, density: FloatArray) -> Estimate:
        """From a density on a grid."""
        q = quantiles(grid, density, [0.5, 0.16, 0.84, 0.025, 0.975]).tolist()
        mean = float(np.trapezoid(grid * density, grid))
        sd = math.sqrt(float(np.trapezoid((grid - mean) ** 2 * density, grid)))
        return cls(q[0], sd, (q[1], q[2]), (q[3], q[4]))

    @classmethod
    def of(cls, draws: FloatArray) -> Estimate:
        """From equally probable values of any shape."""
        q = np.quantile(draws, [0.5, 0.16, 0.84, 0.025, 0.975]).tolist()
        return cls(q[0], float(np.std(draws)), (q[1], q[2]), (q[3], q[4]))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {**vars(self), "ci68": list(self.ci68), "ci95": list(self.ci95)}

    def __str__(self) -> str:
        """Median ± half the 68 % interval, and the 95 % interval [deg]."""
        digits = decimals(self.ci68)
        half = 0.5 * (self.ci68[1] - self.ci68[0])
        low, high = self.ci95
        shown = f"{self.median:.{digits}f}° ± {half:.{max(digits, 1)}f}°"
        return f"{shown}    95 %: {low:.{digits}f} to {high:.{digits}f}°"


def normal_density(median: float, sd: float) -> tuple[FloatArray, FloatArray]:
    """Normal density of φ [1/deg] on a grid [deg] over six standard deviations."""
    step = min(STEP_DEG, 0.1 * sd)
    grid = np.arange(max(median - 6.0 * sd, 0.5), min(median + 6.0 * sd, 85.0), step)
    density = np.exp(-0.5 * ((grid - median) / sd) ** 2)
    return grid, np.asarray(density / np.trapezoid(density, grid))


Verdict = Literal["consistent", "misfit", "out_of_range"]
Edge = Literal["low", "high"]
Name = Annotated[str, Field(validation_alias=AliasChoices("law", "library"))]
Channel = Annotated[str, Field(pattern="^(Fx|Fz|M)$")]


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordSummary:
    """One record, without its forces.

    Attributes
    ----------
    source, rig, simulated
        Where it comes from, and the apparatus.
    n_readings, n_left_out
        Readings that were used, and left out as faulty.
    nrmsd
        Root mean square of data less curve over the peak-to-peak of a whole stroke, by channel [-].
    shift_deg
        By how much the record's forces come later than the model's [deg]; the curves are shifted.
    limit
        Root mean square of data less the best curve over the peak-to-peak above which the record is
        a misfit [-]; ``None`` of simulated forces.
    """

    __pydantic_config__ = ConfigDict(strict=True)

    source: str
    simulated: bool = False
    n_readings: int = 0
    n_left_out: int = 0
    shift_deg: float = 0.0
    limit: float | None = None
    rig: Rig | Tool
    nrmsd: Mapping[Channel, float] = field(default_factory=dict)

    @property
    def coordinate(self) -> str:
        """Name of what the forces are over: ``theta_deg``, ``sinkage_mm`` or a wheel's ``slip``."""
        if not isinstance(self.rig, Tool):
            return "theta_deg"
        return "sinkage_mm" if self.rig.shape.foot else "slip"


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordFit(RecordSummary):
    """One record and the library's curve at the median.

    Attributes
    ----------
    theta_deg
        Leg angles of the window means [deg], the sinkage of a tool [mm] or the slip of a wheel [-],
        shape [m].
    data, curve
        Channels of the record and of the model, shape [c, m]: Fx and Fz [N], or M [N m] in place
        of one of them or of both, as ``nrmsd`` names them.
    band
        Smallest and largest curve at the ends of the 95 % interval and the median, shape [2, c, m].
    tangent
        The curve to first order in the answer's parameters: at parameters of zero, and its slope
        by each, in their order, shape [1 + parameter, c, m].
    measured
        Of a wheel: load [N], sinkage with half a grain [mm], pull [N] and torque [N m], NaN where
        they were not measured, shape [4, m].
    """

    theta_deg: FloatArray = field(repr=False)
    data: FloatArray = field(repr=False)
    curve: FloatArray = field(repr=False)
    band: FloatArray = field(repr=False)
    tangent: FloatArray = field(repr=False)
    measured: FloatArray | None = field(default=None, repr=False)

    @property
    def along(self) -> str:
        """Label of ``theta_deg``."""
        labels = {"theta_deg": "leg angle θ [deg]", "sinkage_mm": "sinkage [mm]"}
        return labels.get(self.coordinate, self.coordinate)

    def place(self, j: int) -> str:
        """Where the j-th mean is, such as ``at -30°``."""
        value = self.theta_deg[j]
        units = {"theta_deg": f"at {value:.0f}°", "sinkage_mm": f"at {value:.0f} mm"}
        return units.get(self.coordinate, f"at a slip of {value:.2g}")

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and words, without the forces."""
        stated = {part.name: getattr(self, part.name) for part in fields(RecordSummary)}
        return {**stated, "rig": self.rig.model_dump(), "nrmsd": dict(self.nrmsd)}


def endings(records: Sequence[Any]) -> list[str]:
    """Endings of the names of each record's variables; of one record there is none."""
    return [f"_{i}" for i in range(len(records))] if len(records) > 1 else [""]


def worst_nrmsd(fits: Sequence[RecordFit]) -> dict[str, float]:
    """Largest residual of any record by channel [-]."""
    names = dict.fromkeys(name for fit in fits for name in fit.nrmsd)
    return {n: max(fit.nrmsd[n] for fit in fits if n in fit.nrmsd) for n in names}


@dataclass(frozen=True, eq=False, kw_only=True)
class AnswerSummary:
    """What an inversion found, as its JSON has it.

    Attributes
    ----------
    verdict
        ``consistent``, ``misfit`` or ``out_of_range``.
    reason
        Why, in one or two sentences.
    edge
        End of the library's range beyond which φ lies: ``low``, ``high`` or ``None``.
    law, law_reason
        Its name, and why it was taken if none was named.
    density_kg_m3, density_sd_kg_m3, density_assumed
        Bulk density that the curves were scaled to.
    leg_friction
        Friction of the leg in the library's model [-].
    cohesion_pa
        Mean cohesion of the soil, or that of the scenario of simulated forces [Pa]; ``None`` by
        libraries, which are of dry soil.
    budget_deg
        Standard deviation of φ by term of the likelihood, the largest first [deg].
    offset_causes_deg
        Error of φ by one standard deviation of each independent cause of *model: offset* [deg],
        with its sign: answers by one law, and one calibration, share these causes.
    phi_peak
        Peak angle of dense soil [deg], where its critical angle was given; ``None`` if it is loose.
    phi_of_force_deg
        φ that ``half`` and ``twice`` the force would be read as [deg], where density and gain were
        not both given with a standard deviation; ``None`` outside the law's range.
    phi_if_damp_deg
        φ if the soil had a cohesion of :data:`~terraphi.experiment.priors.DAMP_PA` [deg], where it
        was taken as dry; else ``None``.
    second_opinion
        Library, median and standard deviation of the answer by other physics, or ``None``.
    warnings
        Warnings, a sentence each.
    provenance
        Versions, hash of the law, time; JSON-able.
    """

    __pydantic_config__ = ConfigDict(strict=True)

    verdict: Verdict
    reason: str
    edge: Edge | None = None
    law: Name
    law_reason: str = ""
    density_kg_m3: Annotated[float, Field(gt=0.0, lt=1e5)]
    density_sd_kg_m3: Annotated[float, Field(ge=0.0, lt=1e5)] | None = None
    density_assumed: bool = True
    leg_friction: Annotated[float, Field(ge=0.0, lt=10.0)] | None = None
    cohesion_pa: Annotated[float, Field(ge=0.0, lt=1e9)] | None = None
    offset_causes_deg: tuple[float, ...] = ()
    phi_peak: Estimate | None = None
    phi_of_force_deg: Mapping[str, float | None] | None = None
    phi_if_damp_deg: float | None = None
    budget_deg: Mapping[str, float] = field(default_factory=dict)
    second_opinion: Mapping[str, Any] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    warnings: Annotated[
        tuple[str, ...], Field(validation_alias=AliasChoices("warnings", "questions"))
    ] = ()


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Answer(Shown, AnswerSummary):
    """What an inversion found.

    Attributes
    ----------
    convention
        What φ means in the library: a yield criterion, or ``rft3d``.
    records
        The records and how the model fits them.
    grid_deg, density
        Posterior density of φ [1/deg] on a grid, shape [k].
    covariance
        Of the data about the curve of the right parameters, all records one after the other, with
        the residual that no term of ``budget_deg`` has, shape [n, n].

    Examples
    --------
    >>> answer = terraphi.invert("li2013:poppy_loose/straight")
    >>> low, high = answer.phi.ci95
    >>> low < answer.phi.median < high
    True
    >>> answer.save("answer")
    >>> terraphi.Answer.load("answer").verdict
    'consistent'
    """

    KIND = "answer"

    convention: str
    records: tuple[RecordFit, ...]
    grid_deg: FloatArray
    density: FloatArray
    covariance: FloatArray

    @cached_property
    def phi(self) -> Estimate:
        """Friction angle [deg], in the library's convention."""
        return Estimate.of_density(self.grid_deg, self.density)

    @property
    def phi_plane_strain(self) -> Estimate | None:
        """φ as that of Mohr-Coulomb soil in plane strain [deg]; ``None`` from 45° of ``rft3d`` on.

        Quantiles map one to one.
        """
        phi = self.phi
        if self.convention == "plane_strain":
            return phi
        if max(phi.ci95) >= 45.0:
            return None
        from terraphi.forward.rft import to_plane_strain

        median, *ends = to_plane_strain([phi.median, *phi.ci68, *phi.ci95]).tolist()
        # To first order, by the ratio of the 68 % intervals.
        sd = phi.sd * (ends[1] - ends[0]) / (phi.ci68[1] - phi.ci68[0])
        return Estimate(median, sd, (ends[0], ends[1]), (ends[2], ends[3]))

    @property
    def source(self) -> str:
        """Where the forces come from."""
        return ", ".join(record.source for record in self.records)

    @property
    def rigs(self) -> list[Rig | Tool]:
        """The different rigs of the records."""
        return list(dict.fromkeys(record.rig for record in self.records))

    @property
    def nrmsd(self) -> dict[str, float]:
        """Residual of the worst record by channel, of peak-to-peak [-]."""
        return worst_nrmsd(self.records)

    @property
    def bekker(self) -> Bekker | None:
        """Numbers of the pressure-sinkage curve of plates; ``None`` without a plate."""
        if not any(isinstance(rig, Tool) for rig in self.rigs):
            return None
        from terraphi.inference.bekker import bekker

        return bekker(self.records)

    def phi_draws(self) -> FloatArray:
        """Equally probable values of φ [deg], shape [draw]."""
        share = (np.arange(QUANTILES) + 0.5) / QUANTILES
        return quantiles(self.grid_deg, self.density, share)

    # -- showing ---------------------------------------------------------------------------------

    def as_dict(self) -> dict[str, Any]:
        """What ``terraphi invert --json`` prints."""
        plane = self.phi_plane_strain
        stated = {part.name: getattr(self, part.name) for part in fields(AnswerSummary)}
        return {
            "phi_deg": {**self.phi.as_dict(), "yield": self.convention},
            "phi_plane_strain_deg": plane.as_dict() if plane else None,
            "phi_plane_strain_reason": "" if plane else NO_PLANE_STRAIN,
            "source": self.source,
            "rig": self.rigs[0].model_dump(),
            **copy.deepcopy(stated),
            "offset_causes_deg": [*self.offset_causes_deg],
            "phi_peak": self.phi_peak.as_dict() if self.phi_peak else None,
            "bekker_kN_m": numbers._asdict() if (numbers := self.bekker) else None,
            "nrmsd": self.nrmsd,
            "n_angles": self.records[0].theta_deg.size,
            "warnings": list(self.warnings),
            "records": [record.as_dict() for record in self.records],
        }

    def summary(self) -> pd.DataFrame:
        """A row for φ: median, standard deviation and intervals."""
        import pandas as pd

        columns = ["median", "sd", "ci68_low", "ci68_high", "ci95_low", "ci95_high"]
        phi = self.phi
        return pd.DataFrame([[phi.median, phi.sd, *phi.ci68, *phi.ci95]], [PHI], columns)

    def _lines(self) -> list[str]:
        assumed = " (assumed)" if self.density_assumed else ""
        rigs = "; ".join(map(str, self.rigs))
        lines = [f"{self.source}: {rigs}, {self.density_kg_m3:g} kg/m³{assumed}, {self.law}"]
        if self.verdict != "out_of_range":
            lines.append(f"φ = {self.phi} ({self.convention})")
            if self.convention != "plane_strain" and self.phi_plane_strain is not None:
                lines.append(f"as plane strain: φ = {self.phi_plane_strain}")
        lines.append(self.reason)
        if self.warnings:
            lines.append(f"warnings in .warnings: {len(self.warnings)}")
        return lines

    _table = summary

    def plot(self, figure: Figure | None = None) -> Figure:
        """Forces with the model's curve, and the posterior of φ; needs nothing but Matplotlib.

        Parameters
        ----------
        figure
            Where to draw; ``None`` makes a figure.
        """
        from terraphi.experiment.figure import Figure as NewFigure
        from terraphi.experiment.history import force_label

        panels = dict.fromkeys((name, r.along) for r in self.records for name in r.nrmsd)
        rolled = [record for record in self.records if record.measured is not None]
        lines, count = (2, len(panels) + 4) if rolled else (1, len(panels) + 1)
        figure = figure or NewFigure(figsize=(10.0, 3.4 * lines), layout="constrained")
        places = figure.subplots(lines, -(-count // lines)).ravel()
        of_channels, of_phi = places[: len(panels)], places[count - 1]
        of_rolled = places[len(panels) : count - 1]
        for axes in places[count:]:
            axes.remove()
        several, legend = len(self.rigs) > 1, dict[str, Any]()
        for axes, (name, along) in zip(of_channels, panels, strict=True):
            drawn: set[str] = set()
            for record in self.records:
                if name not in record.nrmsd or record.along != along:
                    continue
                i, theta, rig = list(record.nrmsd).index(name), record.theta_deg, record.rig
                colour = f"C{self.rigs.index(rig) % 10}"
                body = str(rig) if isinstance(rig, Tool) else OUTLINES[rig.leg].label
                axes.plot(theta, record.curve[i], color=colour, label=body if several else "model")
                # Strokes of one leg have one band; data of several legs have their colours.
                if str(rig) not in drawn:
                    axes.fill_between(theta, *record.band[:, i], color=colour, alpha=0.2, lw=0,
                                      label="95 % of φ")  # fmt: skip
                drawn.add(str(rig))
                if abs(shift := record.shift_deg) >= SHIFT_DRAWN_DEG:
                    label = "of θ" if len(self.records) > 1 else f"of θ by {shift:+.1f}°"
                    axes.plot(theta - shift, record.curve[i], ":", color=colour, lw=1.0,
                              label=f"model before its shift {label}")  # fmt: skip
                dots = colour if several else "black"
                axes.plot(theta, record.data[i], ".", color=dots, ms=4, mec="black", mew=0.4,
                          label="data")  # fmt: skip
            handles, labels = axes.get_legend_handles_labels()
            legend |= dict(zip(labels, handles, strict=True))
            # A wheel without a sinkage has its resistance, or what was measured of it.
            of_wheel = {"Fz": "load [N]", "Fx": "resistance T/R − P [N]"}
            axes.set(xlabel=along, ylabel=of_wheel[name] if along == "slip" else force_label(name))
            axes.axhline(0.0, color="0.7", lw=0.5, zorder=0)
            # A wide band is cut off, so that the data fill the picture.
            rows = [line.get_ydata() for line in axes.get_lines()[:-1]]
            low, high = min(map(np.min, rows)), max(map(np.max, rows))
            low = min(low, 0.0) if along == "slip" else low  # a load is the same at each
            ends = np.array([low, high]) + (high - low) * np.array([-0.6, 0.6])
            axes.set_ylim(*np.clip(axes.get_ylim(), *ends))
        if rolled:
            from terraphi.inference.rolled import draw_rolled

            for record in rolled:
                colour = f"C{self.rigs.index(record.rig) % 10}"
                draw_rolled(of_rolled, record, self, colour, colour if several else "black")
        # Models first, drawn as lines, then what all bodies have.
        entries = dict(sorted(legend.items(), key=lambda each: each[1].get_linestyle() != "-"))
        figure.legend(entries.values(), entries, loc="outside lower center", ncols=7,
                      frameon=False, fontsize="small")  # fmt: skip
        grid, density = self.grid_deg, self.density
        sound = self.verdict == "consistent"
        colour = "C0" if sound else "0.6"
        of_phi.plot(grid, density, color=colour)
        low, high = self.phi.ci68
        inside = (grid >= low) & (grid <= high)
        of_phi.fill_between(grid[inside], density[inside], color=colour, alpha=0.3, lw=0)
        shown = grid[density > 1e-4 * density.max()]
        of_phi.set(
            xlabel=f"φ [deg], {self.convention.replace('_', ' ')}",
            ylabel="posterior density [1/deg]",
            xlim=(shown[0], shown[-1]),
            ylim=(0.0, None),
            title=f"φ = {str(self.phi).partition('    ')[0]}"
            if sound
            else f"{self.verdict.replace('_', ' ')}: not to be used",
        )
        return figure

    # -- files -----------------------------------------------------------------------------------

    def _by_record(self, name: str, arrays: Iterable[FloatArray], *over: str) -> Any:
        """A Dataset with a variable for each record, from arrays of shape [..., c m]."""
        import xarray as xr

        variables: dict[str, Any] = {}
        places: dict[str, Any] = {}
        for record, array, end in zip(self.records, arrays, endings(self.records), strict=True):
            component, along = f"component{end}", f"{record.coordinate}{end}"
            places[component], places[along] = list(record.nrmsd), record.theta_deg
            shape = (*array.shape[: len(over)], *record.data.shape)
            variables[f"{name}{end}"] = ((*over, component, along), array.reshape(shape))
        return xr.Dataset(variables, places)

    def _chains(self) -> FloatArray:
        """Values of φ in four chains, as ArviZ has them [deg], shape [chain, draw]."""
        return np.random.default_rng(0).permutation(self.phi_draws()).reshape(4, -1)

    def to_xarray(self) -> xr.Dataset:
        """Draws of φ as a Dataset [deg]; :meth:`to_inference_data` has all groups of the file."""
        return self._groups()["posterior"]

    def _groups(self) -> dict[str, Any]:
        """Datasets in the layout of ArviZ, by group."""
        import xarray as xr

        records = self.records
        constant = self._by_record("curve", (record.curve for record in records))
        constant.update(self._by_record("band", (record.band for record in records), "bound"))
        tangents = (record.tangent for record in records)
        constant.update(self._by_record("tangent", tangents, "coefficient"))
        for record, end in zip(self.records, endings(self.records), strict=True):
            if record.measured is not None:
                constant[f"measured{end}"] = (("quantity", f"{record.coordinate}{end}"),
                                              record.measured)  # fmt: skip
        constant["covariance"] = (("window", "other_window"), self.covariance)
        constant["grid_deg"] = ("grid", self.grid_deg)
        constant["density"] = ("grid", self.density)
        return {
            "posterior": xr.Dataset({PHI: (("chain", "draw"), self._chains())}),
            "observed_data": self._by_record("force", (record.data for record in records)),
            "constant_data": constant,
        }

    def _predictive_groups(self) -> dict[str, Any]:
        """Forces and log-likelihood at each draw of the posterior, by group of ArviZ."""
        import xarray as xr

        phi, over, sizes = self._chains(), ("chain", "draw"), [r.data.size for r in self.records]
        data = np.concatenate([record.data.ravel() for record in self.records])
        tangent = np.hstack([record.tangent.reshape(2, -1) for record in self.records])
        curves = np.stack([np.ones_like(phi), phi], axis=-1) @ tangent
        rng = np.random.default_rng(0)
        error = rng.standard_normal(curves.shape) @ np.linalg.cholesky(self.covariance).T
        # A window given all others (Bürkner, Gabry & Vehtari 2021, Comput. Stat. 36:1243, eq. 15).
        inverse = np.linalg.inv(self.covariance)
        precision = inverse.diagonal()
        logs = 0.5 * np.log(precision / (2.0 * np.pi))
        logs = logs - 0.5 * ((data - curves) @ inverse) ** 2 / precision
        likelihood = self._by_record("force", [logs], *over) if len(sizes) == 1 else (
            # ArviZ compares what is one variable.
            xr.Dataset({"force": ((*over, "window"), logs)},
                       {"record": ("window", np.repeat(range(len(sizes)), sizes))})
        )  # fmt: skip
        predicted = np.split(curves + error, np.cumsum(sizes)[:-1], axis=-1)
        return {
            "posterior_predictive": self._by_record("force", predicted, *over),
            "log_likelihood": likelihood,
        }

    def to_inference_data(self) -> Any:
        """Draws and data for ArviZ: an ``InferenceData`` (ArviZ 0.x) or a ``DataTree`` (1.x).

        Groups ``posterior``, ``observed_data``, ``posterior_predictive``, ``log_likelihood`` and
        ``constant_data``. Forces are ``force``, over ``component`` and ``theta_deg`` (of tools
        ``sinkage_mm``); of several records ``force_0``, ``component_0`` and so on.

        Notes
        -----
        Of parameters x the forces are normal with the mean g(x), the law's curve to first order
        about the median, and the covariance ``covariance``: the terms of the likelihood, model
        error and density included, and the residual. They are those of another record of a soil
        with these parameters, whose errors are drawn anew. What part of the residual no term
        explains has the size and the correlation over θ of the record's own, so that predictions
        check its course, and the verdict its size.

        Windows are correlated: the log-likelihood is that of each window given all others, whose
        leave-one-out predictive density ``arviz.loo`` then estimates and ``arviz.compare`` compares
        between answers to the same forces. Of several records it is one variable over all windows,
        with the number of the ``record``. Errors that a leg and a tool share are drawn for each.
        """
        import xarray as xr

        groups = {**self._groups(), **self._predictive_groups()}
        with suppress(ImportError):
            import arviz

            if "InferenceData" in vars(arviz):
                return arviz.InferenceData(**groups)
        return xr.DataTree.from_dict(groups)

    def to_netcdf(self, path: Path | str) -> None:
        """Write the answer in the layout of ArviZ, which can open it, without predictions.

        Raises
        ------
        InputError
            If the place cannot be written.
        """
        import xarray as xr

        stated = {"terraphi_file": self.KIND, "answer": json.dumps(self.as_dict(), default=str)}
        groups = {"/": xr.Dataset(attrs=stated), **self._groups()}
        write_netcdf(xr.DataTree.from_dict(groups), Path(path))

    @staticmethod
    def load(path: Path | str) -> Answer:
        """Read an answer from its NetCDF, or from the folder of ``invert --out``.

        Raises
        ------
        InputError
            If there is none, or it is not one of this version.
        """
        from terraphi.inference.stored import read_answer

        path = Path(path)
        return read_answer(path / "answer.nc" if path.is_dir() else path)

    def save(self, folder: Path | str) -> None:
        """Write ``answer.json``, ``answer.nc`` and ``answer.png`` into a folder, all or none.

        Without Matplotlib there is no picture, and a warning is logged.

        Raises
        ------
        InputError
            If the folder cannot be written, or holds other things.
        """
        from terraphi.experiment.outputs import output_folder

        with output_folder(Path(folder), kind="answer", last="answer.json") as place:
            self.to_netcdf(place / "answer.nc")
            try:
                import terraphi.experiment.figure  # noqa: F401  # needs Matplotlib
            except InputError as error:
                log.warning("%s", error)
            else:
                self.plot().savefig(place / "answer.png", dpi=150)
            text = json.dumps(self.as_dict(), indent=1, ensure_ascii=False, default=str)
            (place / "answer.json").write_text(text + "\n", encoding="utf-8")

"""What an inversion left in its folder, and what follows from it and its library."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError
from terraphi.files import damage_told
from terraphi.inference.information import information_share
from terraphi.inference.library import prepare
from terraphi.inference.residual import PaperLikelihood
from terraphi.joint_surrogate import JointSurrogate
from terraphi.library import Library
from terraphi.surrogate import LegSurrogate

FloatArray = NDArray[np.float64]

STEP_DEG = 0.25
"""Half the step of the derivative of the forces with respect to φ [deg]."""
MOST_APART = 0.02
"""Deviation from the saved curve at which one computed again is another's, of the peak [-]."""


@dataclass(frozen=True)
class Saved:
    """What a folder of an inversion holds.

    Attributes
    ----------
    answer
        ``answer.json``.
    draws_deg
        Of φ [deg], shape [draw]; empty if only the answer is there.
    theta_deg
        Leg angles [deg], shape [theta].
    data, best
        Observation vector and the curve at the median [N], shape [2 theta].
    share
        What each angle adds to the information on φ [-], shape [2, theta], if the file says so.
    readings
        Leg angles at which the record was read [rad], shape [sample], if the file says so.
    """

    answer: Mapping[str, Any]
    draws_deg: FloatArray
    theta_deg: FloatArray
    data: FloatArray
    best: FloatArray
    share: FloatArray | None = None
    readings: FloatArray | None = None


@dataclass(frozen=True)
class Again:
    """What follows from the library that was used.

    Attributes
    ----------
    band
        Smallest and largest force over the 95 % interval [N], shape [2, 2 theta]; ``None`` where
        the library's curves are not those that were saved.
    share
        As :attr:`Saved.share`, of the paper's likelihood, whose covariance follows from the data;
        else what the file says.
    bounds_deg
        Friction angles that the library covers [deg].
    library
        The library.
    """

    band: FloatArray | None
    share: FloatArray | None
    bounds_deg: tuple[float, float]
    library: Library


def load(path: Path) -> Saved:
    """Read an inversion's folder, answer or posterior; raises InputError if it is not whole."""
    folder = path if path.is_dir() else path.parent
    answer_file = path if path.suffix == ".json" else folder / "answer.json"
    posterior = path if path.suffix == ".nc" else folder / "posterior.nc"
    if not posterior.is_file():
        return _checked(Saved(_answer(answer_file), *(np.empty(0),) * 4), answer_file)
    import xarray as xr

    why = f"{posterior}: not a whole posterior as 'terraphi invert --out' writes it; make it again"
    with damage_told(why, AttributeError, TypeError):
        with xr.open_datatree(posterior, engine="h5netcdf") as opened:
            tree = opened.load()
        vectors = [
            np.concatenate([_array(tree, f"{group}/{name}") for name in ("Fx", "Fz")])
            for group in ("observed_data", "posterior_predictive_mean")
        ]
        theta = _array(tree, "observed_data/theta_deg")
        draws = _array(tree, "posterior/phi_deg")
        share = None
        if "information_share" in tree:
            share = np.stack([_array(tree, f"information_share/{name}") for name in ("Fx", "Fz")])
        readings = None
        if "reading_deg" in tree["observed_data"]:
            readings = np.radians(_array(tree, "observed_data/reading_deg"))
        answer = json.loads(tree.attrs["answer"])
    sound = len(vectors[0]) == len(vectors[1]) == 2 * len(theta) and len(draws) >= 10
    told = np.zeros((2, len(theta))) if share is None else share
    sound = sound and told.shape == (2, len(theta))
    if readings is not None:
        sound = sound and len(readings) > 1 and bool((np.diff(readings) > 0.0).all())
    if not sound or not all(np.isfinite(v).all() for v in (*vectors, theta, draws, told)):
        raise InputError(f"{posterior}: its arrays do not fit each other; make it again")
    saved = Saved(answer, draws, theta, vectors[0], vectors[1], share, readings)
    return _checked(saved, posterior)


def _array(tree: Any, name: str) -> FloatArray:
    return np.asarray(tree[name].values, dtype=np.float64).ravel()


def _answer(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not an answer of 'terraphi invert --out'") from error
    if not isinstance(found, dict):
        raise InputError(f"{path}: not an answer of 'terraphi invert --out'")
    return found


def _checked(saved: Saved, path: Path) -> Saved:
    """Refuse an answer without what every answer has."""
    answer = saved.answer
    try:
        for name in ("phi_deg", "phi_plane_strain_deg"):
            if name == "phi_deg" or answer[name] is not None:
                numbers = [answer[name]["median"], *answer[name]["ci68"], *answer[name]["ci95"]]
                _, low, high, lower, higher = map(float, numbers)
                assert np.isfinite([float(n) for n in numbers]).all()
                assert low <= high
                assert lower <= higher
        rest = [answer["density_kg_m3"], *(answer["nrmsd"][name] for name in ("Fx", "Fz"))]
        assert np.isfinite([float(n) for n in rest]).all()
        for name in ("source", "leg", "library", "likelihood", "sampler", "verdict", "reason"):
            assert isinstance(answer[name], str)
        assert isinstance(answer["convergence"], dict)
        assert isinstance(answer.get("provenance", {}), dict)
    except (KeyError, TypeError, ValueError, AssertionError) as error:
        raise InputError(f"{path}: not an answer of 'terraphi invert --out'; make it again") from (
            error
        )
    return saved


def recomputed(saved: Saved, name: str | None) -> tuple[Again | None, str]:
    """What follows from the library, and why what is ``None`` cannot be had.

    Parameters
    ----------
    saved
        The inversion.
    name
        Name or file of the library; by default the shipped one of the name in the answer.

    Raises
    ------
    InputError
        If a library was named and is not the one that was used.
    """
    answer = saved.answer
    if not saved.draws_deg.size:
        return None, "posterior.nc does not lie beside the answer"
    wanted = answer.get("provenance", {}).get("library_hash")
    used = str(answer["library"])
    try:
        # Never a path out of somebody's file.
        found = Library.load(name or Path(used).name.removesuffix(".nc"))
    except InputError as error:
        if name is not None:
            raise
        return None, f"the library '{used}' is not at hand ({error}); name it with --library"
    if wanted != found.hash:
        why = f"library '{name or used}' is not the one that was used, or of another version"
        if name is not None:
            raise InputError(why)
        return None, why
    again, apart = _again(saved, found)
    if apart > MOST_APART:
        why = f"the curve at the median comes out {apart:.1%} of the peak from the saved"
        return replace(again, band=None, share=None), why
    return again, ""


def _surrogate(
    library: Library, leg: str, likelihood: str, readings: FloatArray | None
) -> tuple[LegSurrogate | JointSurrogate, float]:
    """Surrogate that a likelihood takes, and the density of the library's soil [kg/m³]."""
    if likelihood == "calibrated":
        prepared = prepare(library, leg, readings=readings)
        return prepared.surrogate, prepared.curves.scenario.soil.density
    curves = library.curves(leg, readings=readings)
    made = LegSurrogate.fit(curves.phi_deg, curves.theta_deg, curves.Fx, curves.Fz)
    return made, curves.scenario.soil.density


def _again(saved: Saved, library: Library) -> tuple[Again, float]:
    """What follows, and how far the curve at the median is from the saved one, of its peak [-]."""
    answer = saved.answer
    leg, likelihood = str(answer["leg"]), str(answer["likelihood"])
    surrogate, density = _surrogate(library, leg, likelihood, saved.readings)
    scale = float(answer["density_kg_m3"]) / density
    phi = answer["phi_deg"]
    low, high = phi["ci95"]
    inside = surrogate.predict(np.linspace(low, high, 101), scale=scale)
    share = saved.share
    if answer["likelihood"] == "paper":
        low, high = surrogate.phi_bounds_deg
        at = np.clip(phi["median"] + np.array([-STEP_DEG, STEP_DEG]), low, high)
        before, after = surrogate.predict(at, scale=scale)
        slope = (after - before) / (at[1] - at[0])
        share = information_share(PaperLikelihood(saved.data, saved.theta_deg).covariance, slope)
    band = np.stack([inside.min(axis=0), inside.max(axis=0)])
    best = surrogate.predict(np.array([phi["median"]]), scale=scale)[0]
    apart = float(np.abs(best - saved.best).max() / np.abs(saved.best).max())
    return Again(band, share, surrogate.phi_bounds_deg, library), apart

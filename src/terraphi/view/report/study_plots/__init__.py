"""Plots of the studies whose data are known, drawn from the data and not from their pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from terraphi.view.report.parts import Part, Text
from terraphi.view.report.study_plots import forces, inversions, numerics

_PLOTS: dict[str, Callable[[Mapping[str, Any]], list[Part]]] = {
    "recovery": inversions.recovery,
    "calibration": inversions.calibration,
    "measured": inversions.measured,
    "benchmark": forces.benchmark,
    "phi_sensitivity": forces.phi_sensitivity,
    "k0": forces.k0,
    "surrogate": forces.surrogate,
    "prediction": forces.prediction,
    "sensitivity": numerics.sensitivity,
    "resolution": numerics.resolution,
    "reading": numerics.reading,
    "design": inversions.design,
    "verification": numerics.verification,
}


def known_plots(name: str, data: Mapping[str, Any]) -> list[Part]:
    """Plots of a study; none if there is no such study or its data are not as expected.

    Parameters
    ----------
    name
        Of the study.
    data
        ``data.json``.
    """
    if name not in _PLOTS:
        return []
    try:
        return _PLOTS[name](data)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        return [Text("Not drawn", (f"The data are not those of a {name} study ({error}).",))]

"""What pictures share: colours that colour-blind readers tell apart, panels, saving."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from terraphi.experiment.files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666"
"""Of Okabe & Ito."""


def save(
    figure: Figure, path: Path | str, *, dpi: int = 150, metadata: Mapping[str, str] | None = None
) -> None:
    """Write a figure in the format of its suffix; raises InputError if that cannot be done."""
    with replacing(Path(path)) as temporary:
        figure.savefig(temporary, dpi=dpi, metadata=metadata)


def panels_of(
    rows: int = 1, columns: int = 1, *, size: tuple[float, float], **options: Any
) -> tuple[Figure, Any]:
    """A figure of a size [in] and its panels, shape [row, column]; options as of ``subplots``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)

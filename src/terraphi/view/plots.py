"""What pictures share: colours that colour-blind readers tell apart, saving."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from terraphi.experiment.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666"
"""Of Okabe & Ito."""


def save(
    figure: Figure, path: Path | str, *, dpi: int = 150, metadata: Mapping[str, str] | None = None
) -> None:
    """Write a figure in the format of its suffix; raises InputError if that cannot be done."""
    with atomic_write(Path(path)) as temporary:
        figure.savefig(temporary, dpi=dpi, metadata=metadata)

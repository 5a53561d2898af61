"""A film of a figure: a GIF, or an MP4 by ffmpeg."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError
from terraphi.outputs import SIGNATURE
from terraphi.plots import BLUE, ORANGE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

FRAMES_PER_SECOND = 12
DOTS_PER_INCH = 100
PALEST = 0.2
"""Opacity of a particle that has lost all its weight [-]."""
COLOURS = "viridis"
"""Evenly stepped in lightness, told apart by colour-blind readers."""


def durations(times: FloatArray) -> list[int]:
    """How long each frame is shown [ms], so that a leg at a constant rate turns at one.

    Frames are taken between blocks of steps, and so not evenly in time.
    """
    if len(times) < 2:
        return [round(1e3 / FRAMES_PER_SECOND)] * len(times)
    gaps = np.diff(times)
    # A GIF counts in hundredths of a second.
    shown = 10.0 * np.round(100.0 / FRAMES_PER_SECOND * gaps / gaps.mean())
    return [int(max(20.0, ms)) for ms in (*shown, shown[-1])]


@contextmanager
def recording(figure: Figure, path: Path, lasts: list[int]) -> Iterator[Callable[[], None]]:
    """A function that adds the figure as it stands to an animation."""
    if path.suffix == ".gif":
        with _recording_gif(figure, path, lasts) as grab:
            yield grab
        return
    from matplotlib.animation import FFMpegWriter

    writer = FFMpegWriter(fps=FRAMES_PER_SECOND, metadata={"comment": SIGNATURE})
    shown = iter(lasts)

    def show() -> None:
        for _ in range(max(1, round(next(shown) * FRAMES_PER_SECOND / 1000.0))):
            writer.grab_frame()

    try:
        with writer.saving(figure, path, dpi=DOTS_PER_INCH):
            yield show
    except subprocess.CalledProcessError as error:
        raise InputError(
            f"ffmpeg ended with status {error.returncode}; one that can encode H.264 is needed, or "
            "name a .gif instead"
        ) from error


@contextmanager
def _recording_gif(figure: Figure, path: Path, lasts: list[int]) -> Iterator[Callable[[], None]]:
    """As :func:`recording`; all frames share one set of colours, so that none changes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure.set_dpi(DOTS_PER_INCH)
    canvas: Any = FigureCanvasAgg(figure)
    palette = Image.new("P", (1, 1))
    palette.putpalette(_palette().ravel().tolist())
    frames: list[Image.Image] = []

    def grab() -> None:
        canvas.draw()
        drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
        frames.append(drawn.quantize(palette=palette, dither=Image.Dither.NONE))

    yield grab
    frames[0].save(
        path,
        "GIF",
        save_all=True,
        append_images=frames[1:],
        duration=lasts[: len(frames)],
        loop=0,
        comment=SIGNATURE.encode(),
    )


def _palette() -> NDArray[np.uint8]:
    """The 256 colours of a GIF: speeds, also paled, greys, and tints of the two colours of forces.

    Returns
    -------
    numpy.ndarray
        Red, green and blue, shape [256, 3].
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_rgb

    def tints(colours: FloatArray, share: float) -> FloatArray:
        return share * colours + (1.0 - share)

    speeds = np.asarray(colormaps[COLOURS](np.linspace(0.0, 1.0, 96)))[:, :3]
    pale = [tints(speeds[::4], share) for share in (0.8, 0.6, 0.4, PALEST)]
    greys = np.repeat(np.linspace(0.0, 1.0, 40)[:, None], 3, axis=1)
    accents = [
        ramp
        for name in (ORANGE, BLUE)
        for ramp in (
            np.array([tints(np.array(to_rgb(name)), share) for share in np.linspace(0.1, 1.0, 8)]),
            np.linspace(0.2, 0.8, 4)[:, None] * np.array(to_rgb(name)),
        )
    ]
    colours = np.concatenate([speeds, *pale, greys, *accents])
    return np.round(255.0 * colours).astype(np.uint8)

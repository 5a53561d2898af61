"""The figure that ``.plot()`` of a result returns."""

from __future__ import annotations

import base64
import io

from terraphi.experiment.errors import needing

with needing("a picture", "Matplotlib", extra="plot"):
    from matplotlib import figure


class Figure(figure.Figure):
    """A Matplotlib figure that shows itself in a notebook without ``pyplot``."""

    def _repr_html_(self) -> str:
        """The picture as HTML."""
        content = io.BytesIO()
        self.savefig(content, format="png", dpi=150)
        data = base64.b64encode(content.getvalue()).decode("ascii")
        style = f"width: {round(100.0 * self.get_figwidth())}px; max-width: 100%"
        return f'<img style="{style}" src="data:image/png;base64,{data}" alt="Figure">'

"""What an answer needs, loaded on import: by the process that the app copies for each file."""

import signal
import sys
import tempfile
from pathlib import Path

signal.signal(signal.SIGINT, signal.SIG_IGN)  # it ends with the app
sys.modules["dask"] = None  # type: ignore[assignment]  # xarray would load all of it to write a file

from terraphi.inference.inversion import invert  # noqa: E402
from terraphi.view import app, page, sections  # noqa: E402

answer = invert("li2013:yuma/straight")
page.render([sections.of_answer(answer)])
with tempfile.TemporaryDirectory() as place:
    app.write_files(answer, Path(place))

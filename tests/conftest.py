"""What every test may count on."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import settings

# A busy machine is no error.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


def pytest_configure() -> None:
    """Let Ctrl-C through to the processes that tests start and interrupt.

    A shell that starts the tests in the background ignores it, and children inherit that.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


class Ran(NamedTuple):
    """How a command ended, and what it printed."""

    status: int
    out: str
    err: str


@pytest.fixture(autouse=True)
def _as_loud_as_at_first() -> Iterator[None]:
    """What one test asks to be told, another does not."""
    yield
    if "terraphi.view.console" in sys.modules:
        sys.modules["terraphi.view.console"].listen()


_READ: dict[Path, Any] = {}


@pytest.fixture
def terraphi(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., Ran]:
    """Run a command in an empty folder, in this process.

    A shipped library is read once for all tests, and so made ready once for its inversions.
    """
    from terraphi.cli.main import main
    from terraphi.experiment.documents import DATA
    from terraphi.library.store import Library

    monkeypatch.chdir(tmp_path)
    read = Library.load

    def recalled(source: Path | str) -> Library:
        place = DATA / "libraries" / f"{source}.nc"
        if Path(source).exists() or not place.is_file():
            return read(source)
        if place not in _READ:
            _READ[place] = read(source)
        return _READ[place]

    monkeypatch.setattr(Library, "load", recalled)

    def run(*args: str) -> Ran:
        monkeypatch.setattr(sys, "argv", ["terraphi", *args])
        status = 0
        try:
            main()
        except SystemExit as leaving:
            status = int(leaving.code or 0)
        return Ran(status, *capsys.readouterr())

    return run

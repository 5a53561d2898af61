"""What the files of a recorded bag have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from terraphi.robot.logs.block import Messages


@dataclass(frozen=True)
class Topic:
    """A topic in a bag.

    Attributes
    ----------
    name, type
        As recorded.
    encoding
        Of its messages; ROS 2 writes ``cdr``.
    number
        By which the file knows it.
    """

    name: str
    type: str
    encoding: str
    number: int

    @property
    def plain_type(self) -> str:
        """Package and name of the type, as in ``unitree_go/LowState``.

        The same message is ``unitree_go/msg/LowState`` in ROS 2 and
        ``unitree_go::msg::dds_::LowState_`` on the robot's own bus.
        """
        parts = [part for part in self.type.replace("::", "/").split("/") if part]
        return f"{parts[0]}/{parts[-1].rstrip('_')}" if len(parts) > 1 else self.type


class Storage(ABC):
    """A file with messages.

    Parameters
    ----------
    path
        The file.
    shown
        What to call it in messages, where the file is a temporary copy.
    """

    def __init__(self, path: Path, *, shown: Path | None = None) -> None:
        self.path = path
        self.shown = shown or path
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        """Remember something for the report, once."""
        if text not in self.notes:
            self.notes.append(text)

    @abstractmethod
    def topics(self) -> list[Topic]:
        """Topics in the file."""

    @abstractmethod
    def batches(self, topics: list[Topic]) -> Iterator[Messages]:
        """Messages on some topics, in the order of the file."""

"""The few things that a robot asks of its disk; a simulated disk can refuse them."""

import os
from pathlib import Path
from typing import BinaryIO, Literal, Protocol


class Files(Protocol):
    """A robot's files. Everything here raises OSError where the disk refuses."""

    def read(self, path: Path) -> bytes | None:
        """Return what a file holds, or None where there is none."""
        ...

    def append(self, path: Path, data: bytes) -> None:
        """Write behind what a file holds; what fails half way may leave a part."""
        ...

    def replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        """Write a file whole or not at all; `durable` ones outlive a power cut."""
        ...

    def cut(self, path: Path, length_bytes: int) -> None:
        """Shorten a file."""
        ...


class LocalFiles:
    """Files of the computer on which the robot runs."""

    def read(self, path: Path) -> bytes | None:
        """Return what a file holds, or None where there is none."""
        try:
            return path.read_bytes()
        except FileNotFoundError:
            return None

    def append(self, path: Path, data: bytes) -> None:
        """Write behind what a file holds."""
        with _opened(path, "ab") as file:
            file.write(data)

    def replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        """Write a file under another name, and give it its own when it is whole."""
        part = path.with_name(f".{path.name}.part")
        with _opened(part, "wb") as file:
            file.write(data)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.replace(part, path)

    def cut(self, path: Path, length_bytes: int) -> None:
        """Shorten a file."""
        os.truncate(path, length_bytes)


def _opened(path: Path, mode: Literal["ab", "wb"]) -> BinaryIO:
    """Open a file for writing; its folder is made where there is none."""
    try:
        return path.open(mode)
    except FileNotFoundError:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open(mode)

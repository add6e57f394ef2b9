"""What robots that share a process have decoded lately: what many hear is decoded once.

No back door: what a payload tells is a function of its bytes alone, and only who has the bytes
can ask. A robot that has a process to itself hears nothing twice, and keeps nothing here.
"""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


class Recall:
    """Keeps the pictures that were asked for last; they can't be written to."""

    def __init__(self) -> None:
        """Keep none."""
        self._most = 0
        self._kept: OrderedDict[tuple[Any, bytes], Any] = OrderedDict()

    def keep(self, most: int) -> None:
        """Keep at most so many from now on."""
        self._most = most
        self._trim()

    def of(self, decode: Callable[[bytes], T], prefix: bytes) -> T:
        """Return what `decode` makes of a prefix; what it raises is not kept."""
        if not self._most:
            return decode(prefix)
        key = (decode, prefix)
        if key in self._kept:
            self._kept.move_to_end(key)
        else:
            self._kept[key] = _frozen(decode(prefix))
            self._trim()
        return self._kept[key]

    def _trim(self) -> None:
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)


def _frozen(picture: T) -> T:
    for value in vars(picture).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return picture


RECALL = Recall()
"""That of this process; a crew of robots that share it says how much is kept."""

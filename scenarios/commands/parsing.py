"""What all commands share: how they refuse, and the words that they take."""

import argparse
import difflib
import re
from typing import TYPE_CHECKING, NoReturn

OK, FAULT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class Parser(argparse.ArgumentParser):
    """Refuses with one sentence and exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, where help is, and leave."""
        message = _CHOICE.sub(_with_the_nearest, message)
        self.exit(BAD_INPUT, f"{self.prog}: {message} (help: {self.prog} --help)\n")


_CHOICE = re.compile(r"invalid choice: '([^']*)' \(choose from ([^)]*)\)")


def _with_the_nearest(found: re.Match[str]) -> str:
    """Return argparse's words about a name that is none, with the one that may be meant."""
    names = re.findall(r"[\w.-]+", found[2])
    near = difflib.get_close_matches(found[1], names, 1)
    meant = f", did you mean {near[0]}?" if near else ";"
    return f"there is no {found[1]}{meant} choose from {', '.join(names)}"


if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[Parser]  # pyright: ignore[reportPrivateUsage]  (argparse has no public name for it)
else:
    Commands = object


def whole(text: str) -> int:
    """Read a whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None


def number(text: str) -> float:
    """Read a number."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from None

"""The command line: `ropeteam COMMAND`. Its commands are the modules of `scenarios.commands`.

Exit codes: 0 ended in order, whatever the outcome; 1 a fault of ours; 2 bad input; 130 Ctrl-C.
"""

import argparse
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Generator, Sequence
from contextlib import contextmanager

from scenarios.commands import (
    agent,
    building,
    chaos,
    compare,
    experiment,
    export,
    host,
    link,
    map,
    plot,
    replay,
    report,
    ros2,
    run,
    shelf,
    show,
    soak,
    stereo,
    sweep,
    view,
)
from scenarios.commands.parsing import BAD_INPUT, FAULT, INTERRUPTED, OK, Parser
from scenarios.errors import StudyError

COMMANDS = (
    run,
    shelf,
    experiment,
    map,
    link,
    chaos,
    replay,
    sweep,
    plot,
    stereo,
    view,
    export,
    ros2,
    building,
    report,
    compare,
    show,
    host,
    agent,
    soak,
)


ROOMS = ("comms", "agents", "sim", "scenarios")


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        """Print the version and leave."""
        from importlib.metadata import version

        print(f"ropeteam {version('ropeteam')}")
        parser.exit(OK)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog="ropeteam",
        description="Teams of mapping robots that share what they see over very thin radio links.",
        epilog=run.EXAMPLES + "\n" + run.EXITS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and leave")
    commands = parser.add_subparsers(
        title="commands", dest="command", metavar="COMMAND", required=True, parser_class=Parser
    )
    for module in COMMANDS:
        module.add(commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    try:
        with _no_ctrl_c_lost():
            args = make_parser().parse_args(argv)
            return args.run(args)
    except StudyError as error:
        print(error, file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        # Where it fell into code made of text (a dataclass's), CPython takes it for unhandled, and
        # under `python -m` dies of it in the end; code that is run after it says otherwise.
        exec("")
        # A robot's task that was cut short has nothing to add.
        logging.getLogger("asyncio").disabled = True
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has left (`ropeteam list | head`); nothing is to be said to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except Exception as error:
        if lacking := _lacking(error):
            print(lacking, file=sys.stderr)
            return BAD_INPUT
        traceback.print_exc()
        print("ropeteam: this is a fault of the program, not of your input", file=sys.stderr)
        return FAULT


def _lacking(error: Exception) -> str:
    """Return what to say where a package that we need is not installed, else nothing."""
    if not isinstance(error, ModuleNotFoundError) or error.name is None:
        return ""
    if error.name.partition(".")[0] in ROOMS:
        return ""
    return (
        f"{error.name}: not installed for {sys.executable}; `make setup` makes a .venv that has all"
        " that ropeteam needs"
    )


@contextmanager
def _no_ctrl_c_lost() -> Generator[None]:
    """Have a Ctrl-C that falls into a destructor or a weak reference's callback counted too.

    Python prints what such code raises, and goes on.
    """
    told = sys.unraisablehook

    def once_more(unraisable: "sys.UnraisableHookArgs") -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            # Not here: whatever is raised in this hook is lost as well.
            threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT)).start()
        else:
            told(unraisable)

    sys.unraisablehook = once_more
    try:
        yield
    finally:
        sys.unraisablehook = told


if __name__ == "__main__":
    sys.exit(main())

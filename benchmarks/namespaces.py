"""Network namespaces of a benchmark's own: a program runs itself again in one.

The namespace is anonymous: it and all interfaces in it are gone when the last process in it ends,
however that ends.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence

INSIDE = "--inside"


def how_to_enter() -> list[str] | str:
    """Return the command that enters a fresh namespace, or the reason why there can't be one."""
    missing = [tool for tool in ("unshare", "ip") if shutil.which(tool) is None]
    if missing:
        return f"no {' and no '.join(missing)} here (util-linux, iproute2)"
    said = ""
    # As root of the machine, else as root of a user namespace of our own.
    for flags in ("-n", "-rn"):
        tried = ["unshare", flags]
        done = subprocess.run([*tried, "true"], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return tried
        said = done.stderr.strip()
    return f"this system makes no network namespace ({said})"


def run_inside(script: str, arguments: Sequence[str], enter: Sequence[str]) -> str:
    """Run a script again, in a namespace of its own; return what it prints."""
    command = [*enter, sys.executable, os.path.abspath(script), INSIDE, *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def sh(command: str) -> None:
    """Run a command; raise CalledProcessError with its words on standard error where it fails."""
    subprocess.run(command.split(), check=True)


def quietly(command: str) -> None:
    """Run a command that may fail."""
    subprocess.run(command.split(), check=False, stderr=subprocess.DEVNULL)

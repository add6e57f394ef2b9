"""Computers that are none: network namespaces with addresses of their own, and a cable between."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CLI = (sys.executable, "-m", "scenarios.cli")
HERE, THERE = "10.77.0.1", "10.77.0.2"
PATIENCE_S = 100.0


def sh(*words: str) -> None:
    subprocess.run(words, check=True, capture_output=True)


@dataclass
class Cable:
    """Two namespaces, each a computer of its own as far as the network goes."""

    here: str
    there: str

    def cut(self) -> None:
        sh("ip", "-n", self.here, "link", "set", "cable", "down")

    def mend(self) -> None:
        sh("ip", "-n", self.here, "link", "set", "cable", "up")


@contextmanager
def two_computers() -> Iterator[Cable]:
    """Make two namespaces with a cable between them, or skip with the reason."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("network namespaces need root and the ip command (iproute2)")
    mark = f"rt{os.getpid()}"
    cable = Cable(f"{mark}a", f"{mark}b")
    made: list[str] = []
    try:
        for name in (cable.here, cable.there):
            done = subprocess.run(
                ["ip", "netns", "add", name], capture_output=True, text=True, check=False
            )
            if done.returncode:
                pytest.skip(f"no network namespace can be made here: {done.stderr.strip()}")
            made.append(name)
            sh("ip", "-n", name, "link", "set", "lo", "up")
        end = ["type", "veth", "peer", "name", "cable", "netns", cable.there]
        sh("ip", "-n", cable.here, "link", "add", "cable", *end)
        for name, address in ((cable.here, HERE), (cable.there, THERE)):
            sh("ip", "-n", name, "addr", "add", f"{address}/24", "dev", "cable")
            sh("ip", "-n", name, "link", "set", "cable", "up")
        yield cable
    finally:
        for name in made:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


@dataclass
class Shop:
    """Starts programs, and ends all of them in the end."""

    folder: Path
    running: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, log: str, *words: str, inside: str | None = None) -> subprocess.Popen[bytes]:
        enter = ["ip", "netns", "exec", inside] if inside else []
        with (self.folder / log).open("wb") as out:
            process = subprocess.Popen(
                [*enter, *CLI, *words],
                stdout=out,
                stderr=subprocess.STDOUT,
                cwd=self.folder,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
            )
        self.running.append(process)
        return process

    def said(self, log: str) -> str:
        return (self.folder / log).read_text()

    def end(self) -> None:
        for process in self.running:
            process.terminate()
        for process in self.running:
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextmanager
def shop(folder: Path) -> Iterator[Shop]:
    ours = Shop(folder)
    try:
        yield ours
    finally:
        ours.end()


def wait_for(what: Callable[[], bool], why: str, most_s: float = PATIENCE_S) -> None:
    deadline_s = time.monotonic() + most_s
    while not what():
        assert time.monotonic() < deadline_s, why
        time.sleep(0.1)


def certificates(folder: Path, names: Sequence[str]) -> Path:
    """Make an authority, a hub and some clients, as docs/security.md says it."""
    if shutil.which("openssl") is None:
        pytest.skip("there is no openssl command to make certificates with")
    page = (ROOT / "docs" / "security.md").read_text()
    script = page.split("```sh\n", 1)[1].split("```", 1)[0]
    script = script.replace("IP:192.168.7.1", f"IP:{HERE}")
    script += "".join(f'\ncertify {name} clientAuth "DNS:{name}"' for name in names)
    subprocess.run(["sh", "-ec", script], cwd=folder, check=True, capture_output=True)
    return folder / "keys"

"""What the live view costs a run, in CPU seconds of its process, and that it changes no record.

    python benchmarks/view_cost.py [NAME] [--runs N] [--limit-s S]

Runs a scenario N times by itself and N times with its page served to a watcher, by turns, all
robots in one process. The watcher takes all that is told, as a browser does, in its own process.
"""

import argparse
import asyncio
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from tornado.websocket import websocket_connect

from comms.kernels import warm_all
from scenarios import load, run
from scenarios.view.livepage import LivePage

RECORDS = ("summary.json", "looks.csv", "frames.csv", "maps.csv", "events.csv")


async def watch(address: str) -> int:
    """Let a run go on that waits, and take what is told; return how many bytes."""
    page = await websocket_connect(address.replace("http", "ws") + "socket", max_message_size=2**28)
    await page.write_message(json.dumps({"do": "go"}))
    taken = 0
    while (told := await page.read_message()) is not None:
        taken += len(told)
    return taken


def one_run(scenario: str, limit_s: float, out: Path, *, watched: bool) -> None:
    """Be one run; print the CPU seconds that it took from its first instant to its report."""
    watchers: list[subprocess.Popen[bytes]] = []

    def begin(said: str) -> None:
        if "http" in said:
            command = [sys.executable, __file__, "--watch", said.rsplit(maxsplit=1)[-1]]
            watchers.append(subprocess.Popen(command, stdout=subprocess.DEVNULL))

    page = LivePage(opens=False, paused=True, say=begin) if watched else None
    told = load(scenario, ["air=memory", f"limit_s={limit_s}"])
    warm_all()
    before = resource.getrusage(resource.RUSAGE_SELF)
    run(told, out, quiet=True, page=page)
    after = resource.getrusage(resource.RUSAGE_SELF)
    print(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    if watched and [watcher.wait(30) for watcher in watchers] != [0]:
        sys.exit("nobody watched")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", nargs="?", default="cliff")
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--limit-s", type=float, default=900.0)
    parser.add_argument("--one", metavar="FOLDER", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--watched", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--watch", metavar="ADDRESS", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.watch:
        print(asyncio.run(watch(args.watch)))
        return
    if args.one:
        one_run(args.scenario, args.limit_s, args.one, watched=args.watched)
        return
    costs: dict[bool, list[float]] = {False: [], True: []}
    seen: set[bytes] = set()
    with tempfile.TemporaryDirectory() as folder:
        for number in range(args.runs):
            for watched in (False, True):
                out = Path(folder) / f"{number}-{watched}"
                command = [sys.executable, __file__, args.scenario, "--one", str(out)]
                command += ["--limit-s", str(args.limit_s), *(["--watched"] if watched else [])]
                done = subprocess.run(command, check=True, capture_output=True, text=True)
                costs[watched].append(float(done.stdout.split()[-1]))
                print(
                    f"{'watched' if watched else 'alone':8}{costs[watched][-1]:8.2f} s", flush=True
                )
                seen.add(b"".join((out / name).read_bytes() for name in RECORDS))
    alone, watched_s = statistics.median(costs[False]), statistics.median(costs[True])
    print(f"the live view takes {100 * (watched_s / alone - 1):+.1f} % CPU")
    print("records equal byte for byte" if len(seen) == 1 else "RECORDS DIFFER")
    sys.exit(len(seen) != 1)


if __name__ == "__main__":
    main()

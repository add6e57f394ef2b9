"""What each robot of a fleet sends and keeps, for fleets of 4 to 1,000 robots.

    python benchmarks/fleet_size.py [--sizes 4,16,64,256,1000] [--until 240] [--no-horizon]

Simulates whole fleets in one process (`scenarios.fleet`), and prints for the second half of the
time: bytes per robot and minute by kind of frame, digest length, how many team-mates count, tiles
and payload bytes in a robot's store, different parts of tiles that it
remembers as what others have, and this process's
memory per robot. `--no-horizon`: everything is for everybody, as in small teams.
"""

import argparse
import resource
import subprocess
import sys
import time

from scenarios.fleet import Fleet, FleetSettings, account

KINDS = ("map", "anchor", "digest", "status")
COLUMNS = (
    "robots", "looks", "B_per_min", *(f"{kind}_B" for kind in KINDS), "digest_len", "mates",
    "tiles", "store_kB", "parts", "MB_each", "cells_k", "cpu_s",
)  # fmt: skip


def memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def one(robots: int, until_s: float, horizon_m: float | None) -> None:
    before_mb, started_s = memory_mb(), time.process_time()
    region_m = None if horizon_m is None else FleetSettings(1).region_m
    fleet = Fleet(FleetSettings(robots, horizon_m=horizon_m, region_m=region_m))
    found = account(fleet, until_s / 2, until_s)
    row = (
        robots,
        found.looks,
        found.all_bytes_per_min,
        *(found.bytes_per_min.get(kind, 0.0) for kind in KINDS),
        found.digest_bytes,
        found.mates,
        found.tiles,
        found.payload_bytes / 1e3,
        found.beliefs,
        (memory_mb() - before_mb) / robots,
        fleet.frame.rows * fleet.frame.cols / 1e3,
        time.process_time() - started_s,
    )
    print(" ".join(f"{value:10.4g}" for value in row), flush=True)
    fleet.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="4,16,64,256,1000")
    parser.add_argument("--until", type=float, default=240.0, metavar="S")
    parser.add_argument("--no-horizon", action="store_true")
    args = parser.parse_args()
    horizon_m = None if args.no_horizon else FleetSettings(1).horizon_m
    sizes = [int(size) for size in args.sizes.split(",")]
    if len(sizes) == 1:
        one(sizes[0], args.until, horizon_m)
        return
    print(" ".join(f"{name:>10}" for name in COLUMNS), flush=True)
    for size in sizes:  # each in a process of its own, so that memory can be told apart
        words = ["--sizes", str(size), "--until", str(args.until)]
        words += ["--no-horizon"] if args.no_horizon else []
        subprocess.run([sys.executable, __file__, *words], check=True)


if __name__ == "__main__":
    main()

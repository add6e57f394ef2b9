"""How fast teams of 1 to 64 robots run on this computer, and what their time goes into.

    python benchmarks/team_size.py [--sizes 1,2,4] [--saturated] [--silent] [--robot-s 2400]
                                   [--air memory] [-- --set key=value ...]

Runs the scenario `open` (explorers at 0.05 m/s that share over 9600 bps) with each number of
robots, each run for so many robot-seconds, and prints simulated seconds per wall second (from the
first instant until all robots have ended: starting them and drawing pictures are not counted) and
per CPU second (the runner's whole time counts there), how long it took until all processes were
up, the memory that each robot's process shares with no other, duty of the links, and CPU per look
and per frame heard. `--saturated` has every robot send without a pause, `--silent` nothing at all:
the difference is what frames cost.
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

MEBI = 1 << 20
SATURATED = ("--set", "sharing.policy=raw", "--set", "map.cell_m=0.1")
SILENT = ("--set", "links.up=false")
COLUMNS = (
    "robots", "simulated_s", "x_wall", "x_cpu", "up_s", "unique_mb", "duty", "looks", "heard",
    "ms_per_look", "us_per_heard", "robots_cpu_s", "runner_cpu_s", "grants_per_s",
)  # fmt: skip


def one_run(robots: int, limit_s: float, options: list[str]) -> dict[str, float]:
    """Run one team and return the row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [
            sys.executable, "-m", "scenarios.cli", "run", "open", "--quiet", "--out", str(out),
            "--set", f"robots.count={robots}", "--set", f"limit_s={limit_s:g}",
        ]  # fmt: skip
        subprocess.run([*command, *options], check=True)
        host = json.loads((out / "host.json").read_text())
        summary = json.loads((out / "summary.json").read_text())
    team = list(summary["robots"].values())
    costs = [cost for name, cost in host["processes"].items() if name != "runner"]
    robots_cpu_s = sum(cost["cpu_s"] for cost in costs)
    runner_cpu_s = host["processes"]["runner"]["cpu_s"]
    looks = sum(robot["looks"] for robot in team)
    heard = sum(robot["received_frames"] for robot in team)
    return {
        "robots": robots,
        "simulated_s": summary["simulated_s"],
        "x_wall": summary["simulated_s"] / host["played_s"],
        "x_cpu": summary["simulated_s"] / (robots_cpu_s + runner_cpu_s),
        "up_s": host["launch_s"],
        "unique_mb": max(cost.get("unique_memory_bytes", 0) for cost in costs) / MEBI,
        "duty": sum(robot["link_busy_fraction"] for robot in team) / robots,
        "looks": looks,
        "heard": heard,
        "ms_per_look": 1e3 * robots_cpu_s / max(1, looks),
        "us_per_heard": 1e6 * robots_cpu_s / max(1, heard),
        "robots_cpu_s": robots_cpu_s,
        "runner_cpu_s": runner_cpu_s,
        "grants_per_s": host["grants"] / summary["simulated_s"],
    }


def main() -> None:
    """Run all sizes, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="1,2,4,8,16,32,64")
    parser.add_argument("--robot-s", type=float, default=2400.0, help="simulated s times robots")
    parser.add_argument("--saturated", action="store_true")
    parser.add_argument("--silent", action="store_true")
    parser.add_argument("--air", choices=("zenoh", "memory"), default="zenoh")
    parser.add_argument("--csv", type=Path, help="keep the table here")
    parser.add_argument("rest", nargs="*", help="options of `ropeteam run`, after --")
    args = parser.parse_args()
    options = ["--set", f"air={args.air}", *args.rest]
    options += SATURATED if args.saturated else ()
    options += SILENT if args.silent else ()
    print(" ".join(f"{name:>12}" for name in COLUMNS), flush=True)
    rows: list[dict[str, float]] = []
    for robots in map(int, args.sizes.split(",")):
        row = one_run(robots, max(60.0, args.robot_s / robots), options)
        print(" ".join(f"{row[name]:12.5g}" for name in COLUMNS), flush=True)
        rows.append(row)
    if args.csv:
        with args.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()

"""How fast a scenario runs on this computer, and what its time goes into.

    python benchmarks/run_speed.py [NAME] [--runs N] [-- --set key=value ...]

Runs it N times over Zenoh and once in one process, and prints simulated seconds per wall second,
start-up, grants per second and CPU seconds; says whether all records were equal byte for byte.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

RECORDS = ("summary.json", "looks.csv", "frames.csv", "maps.csv")


def one_run(scenario: str, sets: list[str], out: Path) -> dict[str, float]:
    command = [sys.executable, "-m", "scenarios.cli", "run", scenario, "--quiet", "--out", str(out)]
    subprocess.run([*command, *sets], check=True)
    host = json.loads((out / "host.json").read_text())
    summary = json.loads((out / "summary.json").read_text())
    return {
        "simulated s": summary["simulated_s"],
        "wall s": host["wall_s"],
        "speed": summary["simulated_s"] / host["wall_s"],
        "start-up s": host["startup_s"],
        "grants/s": host["grants"] / host["wall_s"],
        "CPU s": sum(process["cpu_s"] for process in host["processes"].values()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", nargs="?", default="cliff")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("rest", nargs="*", help="options of `ropeteam run`, after --")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        forms = [("zenoh", n) for n in range(args.runs)] + [("memory", 0)]
        seen: set[bytes] = set()
        for air, number in forms:
            out = Path(folder) / f"{air}-{number}"
            facts = one_run(args.scenario, ["--set", f"air={air}", *args.rest], out)
            words = "  ".join(f"{name} {value:9.1f}" for name, value in facts.items())
            print(f"{air:7}{words}", flush=True)
            seen.add(b"".join((out / name).read_bytes() for name in RECORDS))
        print("records equal byte for byte" if len(seen) == 1 else "RECORDS DIFFER")
        sys.exit(len(seen) != 1)


if __name__ == "__main__":
    main()

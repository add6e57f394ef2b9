"""Coverage-guided fuzzing of all that takes bytes off the air.

    python fuzz/run.py                         one million inputs for each target
    python fuzz/run.py --runs 10000000 digest
    python fuzz/run.py member -- -max_len=64   (what follows -- goes to libFuzzer)

Targets, and what each must never do, are in `tests/hostile.py` and `tests/hostile_team.py`. What is
learned stays in `fuzz/corpus`, what libFuzzer says in `fuzz/log`. An input that breaks a promise is
written to `fuzz/found`; `python fuzz/run.py TARGET -- FILE` runs it again. Kernels are compiled
with bounds checks.
"""

import argparse
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
CORPUS, FOUND, LOG = HERE / "corpus", HERE / "found", HERE / "log"
LIMIT_MB = 2048
"""No process may hold more."""
GROWTH_MB = 64
"""No single input may make a process hold so much more than it ever did."""
GRID_GROWTH_MB = 512
"""A whole grid may be large and flat: 200 honest bytes hold ten million cells."""
TARGETS = (
    "frame",
    "map",
    "anchor",
    "digest",
    "status",
    "fix",
    "tether",
    "packet",
    "tile",
    "paper",
    "occupancy",
    "grid",
    "member",
)
SHARE = {"tile": 10, "paper": 10, "occupancy": 10, "grid": 20, "member": 50}
"""Slow targets get one run of so many."""
LONGEST_BYTES = {"tile": 400, "paper": 400, "occupancy": 400, "grid": 200}


def main() -> int:
    """Fuzz the targets that are named, one after another; 1 if one broke."""
    summary_line = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(description=summary_line)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}")
    parser.add_argument("--runs", type=int, default=1_000_000, help="inputs for each target")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    at = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    args, more = parser.parse_args(sys.argv[1:at]), sys.argv[at + 1 :]
    unknown = sorted(set(args.targets) - set(TARGETS))
    if unknown:
        parser.error(f"no target {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    if args.inside:
        fuzz(args.targets[0], args.runs, more)
    broken = [t for t in args.targets or TARGETS if not holds(t, args.runs, more)]
    print(f"broken: {', '.join(broken)}; see {FOUND}" if broken else "nothing broke")
    return 1 if broken else 0


def holds(target: str, runs: int, more: list[str]) -> bool:
    """Fuzz one target in a process of its own: libFuzzer ends the one that it runs in."""
    LOG.mkdir(exist_ok=True)
    log = LOG / f"{target}.txt"
    count = max(1, runs // SHARE.get(target, 1))
    command = [sys.executable, __file__, target, "--inside", "--runs", str(count), "--", *more]
    # Kernels with bounds checks must not be mistaken for those that robots use.
    cache = Path(os.environ.get("ROPETEAM_CACHE", Path.home() / ".cache" / "ropeteam")) / "fuzz"
    checked = {"NUMBA_BOUNDSCHECK": "1", "ROPETEAM_CACHE": str(cache)}
    with log.open("w") as file:
        ended = subprocess.run(command, env=os.environ | checked, stderr=file, check=False)
    print(f"{target:10}{summary(log.read_text(errors='replace'))}", flush=True)
    return ended.returncode == 0


def summary(log: str) -> str:
    """Return one line of what libFuzzer wrote: how many, how fast, and what broke."""
    done = re.findall(r"#(\d+)\s.*cov: (\d+)", log)
    speed = re.findall(r"stat::average_exec_per_sec:\s+(\d+)", log)
    inputs, branches = done[-1] if done else ("0", "0")
    line = f"{int(inputs):>12,} inputs, {speed[-1] if speed else '?':>6}/s, {branches:>4} branches"
    broken = re.findall(r"^(?:\w+\.)*\w*(?:Error|Exception)\b.*$|^==\d+== ERROR.*$", log, re.M)
    return f"{line}, broken: {broken[0]}" if broken else line


def fuzz(name: str, runs: int, more: list[str]) -> None:
    """Fuzz one target in this process, and end it."""
    try:
        import atheris  # noqa: PLC0415  (the parent needs none)
    except ImportError:
        sys.exit("ModuleNotFoundError: atheris is not installed (pip install atheris)")
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    with atheris.instrument_imports(include=["comms", "agents"], exclude=compiled()):  # pyright: ignore[reportAttributeAccessIssue]
        import hostile  # noqa: PLC0415  # pyright: ignore[reportMissingImports]
        import hostile_seeds  # noqa: PLC0415  # pyright: ignore[reportMissingImports]
        import hostile_team  # noqa: PLC0415  # pyright: ignore[reportMissingImports]

    target = {**hostile.TARGETS, **hostile_team.TARGETS}[name]
    corpus = CORPUS / name
    corpus.mkdir(parents=True, exist_ok=True)
    FOUND.mkdir(exist_ok=True)
    for number, seed in enumerate(hostile_seeds.SEEDS[name]()):
        target(seed)  # also compiles the kernels before anything is timed
        (corpus / f"seed-{number:03}").write_bytes(seed)
    options = [
        f"-runs={runs}",
        f"-max_len={LONGEST_BYTES.get(name, 600)}",
        f"-rss_limit_mb={LIMIT_MB}",
        f"-artifact_prefix={FOUND}/{name}-",
        "-timeout=30",
        "-print_final_stats=1",
    ]
    files = [] if any(Path(word).is_file() for word in more) else [str(corpus)]
    growth_mb = GRID_GROWTH_MB if name == "grid" else GROWTH_MB
    atheris.Setup([sys.argv[0], *options, *more, *files], thrifty(target, growth_mb))  # pyright: ignore[reportAttributeAccessIssue]
    atheris.Fuzz()  # pyright: ignore[reportAttributeAccessIssue]


def compiled() -> list[str]:
    """Return the modules whose branches can't be watched, because numba compiles them."""
    files = [path for room in ("comms", "agents") for path in (ROOT / room).rglob("*.py")]
    kernels = [path for path in files if re.search(rb"^@(kernel|part)", path.read_bytes(), re.M)]
    return [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in kernels]


def thrifty(target: Callable[[bytes], None], growth_mb: int) -> Callable[[bytes], None]:
    """Hold a target to what it may add to the most memory that the process ever held."""
    most_kb = 0

    def held(data: bytes) -> None:
        nonlocal most_kb
        target(data)
        now_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if most_kb and now_kb - most_kb > growth_mb * 1024:
            raise MemoryError(f"{len(data)} bytes took {(now_kb - most_kb) // 1024} MB")
        most_kb = now_kb

    return held


if __name__ == "__main__":
    sys.exit(main())

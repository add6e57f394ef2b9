"""Draws the figures of the pages that explain (`make figures`), from runs and from the code itself.

Two minutes on two cores; nothing is drawn that was not computed here. Single ones by their names:

    python docs/figures.py look localisation-images
"""

import shutil
import sys
import tempfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from agents.geometry import Floats
from agents.maps.elevation import Estimate, fuse_origins
from comms.timebase import to_s
from scenarios import Run, load, open_run, run
from scenarios.experiments.figure import COLOURS, save_figure
from scenarios.experiments.frame import Options
from scenarios.experiments.frame import run as experiment
from scenarios.logs.handed import read_life
from scenarios.onelook import look_again, save_picture
from scenarios.palette import INK, MUTED, robot_colours

IMAGES = Path(__file__).parent / "images"

# --- the team map never counts twice ---------------------------------------------------------

SHAPE = (60, 60)
SIGMA_M = 0.10
TEAM = 4
ROUNDS = 8


def counting_twice(figure: Figure) -> None:
    """Draw what four robots claim to know, and how wrong they are, as maps go round and round."""
    rng = np.random.default_rng(1)
    own = [_measured(rng) for _ in range(TEAM)]
    naive, apart = list(own), [{robot: layer} for robot, layer in enumerate(own)]
    rows: list[tuple[float, float, float, float]] = []
    for _ in range(ROUNDS + 1):
        kept = [fuse_origins(list(layers.values()), SHAPE) for layers in apart]
        rows.append((*_claim_and_error(naive), *_claim_and_error(kept)))
        ahead = [(robot + 1) % TEAM for robot in range(TEAM)]
        naive = [fuse_origins([naive[r], naive[mate]], SHAPE) for r, mate in enumerate(ahead)]
        apart = [{**apart[mate], **apart[r]} for r, mate in enumerate(ahead)]
    values = np.array(rows) * 100
    figure.set_size_inches(11, 4.4)
    titles = ("Fused maps are fused again", "Each robot's measurements stay apart")
    for index, title in enumerate(titles):
        axes = figure.add_subplot(1, 2, index + 1)
        claim, error = values[:, 2 * index], values[:, 2 * index + 1]
        axes.plot(error, "o-", color=INK, label="how far the map is off (rms)")
        axes.plot(claim, "s--", color=COLOURS[1], label="how far it claims to be off (sigma)")
        axes.set(xlabel="times that maps went round the team", ylabel="cm", ylim=(0, 11))
        axes.set_title(title)
        axes.legend()


def _measured(rng: np.random.Generator) -> Estimate:
    """Return what a robot measured of flat ground."""
    noise = rng.normal(0.0, SIGMA_M, SHAPE)
    return Estimate(noise, np.full(SHAPE, SIGMA_M**2), np.ones(SHAPE, dtype=np.uint16))


def _claim_and_error(maps: list[Estimate]) -> tuple[float, float]:
    claims = [float(np.sqrt(one.variance_m2.mean())) for one in maps]
    errors = [float(np.sqrt((one.elevation_m**2).mean())) for one in maps]
    return sum(claims) / TEAM, sum(errors) / TEAM


# --- virtual time ------------------------------------------------------------------------------

SHOWN_S = (59.9, 60.7)


def windows(out: Path) -> Callable[[Figure], None]:
    """Return what draws the windows of time that robots were granted in a run, and its frames."""
    done = _run("cliff", out, "limit_s=70")
    names = list(done.scenario.robots)
    colours = robot_colours(names)

    def draw(figure: Figure) -> None:
        figure.set_size_inches(11, 4.0)
        axes = figure.add_subplot()
        for line, name in enumerate(names):
            ends_s = [to_s(w.grant.end_ns) for w in read_life(out / f"{name}.mcap").windows]
            edges = np.clip(np.unique([SHOWN_S[0], *ends_s, SHOWN_S[1]]), *SHOWN_S)
            bars = [(a, b - a) for a, b in pairwise(edges) if b > a]
            axes.broken_barh(
                bars, (line - 0.28, 0.56), facecolor=colours[name], edgecolor="white", alpha=0.55
            )
        for frame in done.frames:
            start_s, end_s, arrive_s = (frame[key] for key in ("start_s", "end_s", "arrive_s"))
            told = isinstance(start_s, float) and isinstance(end_s, float)
            if not told or not isinstance(arrive_s, float):
                continue
            if not (SHOWN_S[0] <= start_s and arrive_s <= SHOWN_S[1]):
                continue
            here, there = names.index(str(frame["from"])), names.index(str(frame["to"]))
            axes.plot([start_s, end_s], [here, here], color=INK, lw=3, solid_capstyle="butt")
            axes.annotate(
                "", (arrive_s, there), (end_s, here),
                arrowprops={"arrowstyle": "->", "color": MUTED, "lw": 1.0},
            )  # fmt: skip
        axes.set_yticks(range(len(names)), names)
        axes.set(xlim=SHOWN_S, xlabel="simulated time, s")
        axes.set_title("Windows in which each robot may run by itself, and frames between them")
        axes.invert_yaxis()

    return draw


# --- worth per bit -----------------------------------------------------------------------------

POLICIES = ("value", "latest-first", "paper", "raw")


def worth(out: Path) -> Callable[[Figure], None]:
    """Return what draws how much the Cliff-bot knows for the bytes that the RECON-bot sent."""
    curves = {policy: _curve(out / policy, policy) for policy in POLICIES}

    def draw(figure: Figure) -> None:
        figure.set_size_inches(11, 4.6)
        axes = figure.add_subplot()
        for (policy, (sent_kb, kbits)), colour in zip(curves.items(), COLOURS, strict=False):
            axes.plot(sent_kb, kbits, label=policy, color=colour, lw=2)
        axes.set(xlabel="sent by the RECON-bot, kB", ylabel="known to the Cliff-bot, kbit")
        axes.set_title("What the bytes bring, by what is sent first (cliff, 600 bps, 20 minutes)")
        axes.legend()

    return draw


def _curve(out: Path, policy: str) -> tuple[Floats, Floats]:
    done = _run("cliff", out, "limit_s=1200", "links.rate_bps=600", f"sharing.policy={policy}")
    sent = sorted(
        (float(f["end_s"] or 0.0), float(f["bytes"] or 0.0))
        for f in done.frames
        if f["from"] == "recon" and f["to"] == "cliffbot"
    )
    ends_s, bytes_sent = np.array([s for s, _ in sent]), np.cumsum([b for _, b in sent])
    rows = [row for row in done.maps if row["robot"] == "cliffbot"]
    t_s = np.array([float(row["t_s"] or 0.0) for row in rows])
    bits = np.array([float(row["heard_bits"] or 0.0) for row in rows])
    return np.interp(t_s, ends_s, bytes_sent, left=0.0) / 1000, bits / 1000


# --- eyes --------------------------------------------------------------------------------------

WALKED_SEEDS = 2
LOOK = 7


def localisation_images(out: Path) -> None:
    """Draw Fig. 19 from rendered images: the figure of the experiment over two seeds."""
    options = Options(WALKED_SEEDS, {"source": ["images"]})
    experiment("localisation", options, out, jobs=1)
    shutil.copyfile(out / "figure.png", IMAGES / "localisation-images.png")


def look(out: Path) -> None:
    """Draw what stereo eyes saw in one look over the edge of `field`."""
    changes = ("sensor.kind=stereo", "method=team-information", f"planner.max_looks={LOOK}")
    _run("field", out, *changes, "air=memory", "limit_s=200")
    save_picture(look_again(out, "recon", LOOK), IMAGES / "look.png")


def _run(name: str, out: Path, *changes: str) -> Run:
    result = run(load(name, changes), out, quiet=True, picture=False)
    return open_run(result.out)


def _drawn(name: str, draw: Callable[[Figure], None]) -> None:
    save_figure(IMAGES / f"{name}.png", draw)


FIGURES: dict[str, Callable[[Path], None]] = {
    "counting-twice": lambda _: _drawn("counting-twice", counting_twice),
    "windows": lambda out: _drawn("windows", windows(out)),
    "worth": lambda out: _drawn("worth", worth(out)),
    "look": look,
}
SLOW: dict[str, Callable[[Path], None]] = {"localisation-images": localisation_images}
"""Minutes each: drawn only when asked for by name."""


def main() -> int:
    """Draw the figures that are named, or all that are quick."""
    every = FIGURES | SLOW
    names = sys.argv[1:] or list(FIGURES)
    unknown = [name for name in names if name not in every]
    if unknown:
        print(f"{unknown[0]}: no such figure; must be one of {', '.join(every)}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            every[name](Path(folder) / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())

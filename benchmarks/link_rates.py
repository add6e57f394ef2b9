"""Configured against measured rate: the emulated link, and the kernel's `tc tbf` beside it.

    python benchmarks/link_rates.py [--frames 1000] [--quick]

1. The link on the virtual clock: 10,000 frames at each rate.
2. The link on the wall clock (two processes, Zenoh between them) and `tc tbf` (two network
   namespaces, UDP between them), the same charged bytes: how long from the first packet's arrival
   to the last one's. Whoever sends hands all packets over at once; the shaper was idle before.
3. The link on the wall clock, frame after frame, the fastest `--frames` of them: how late, and
   whether it adds up.

Takes five minutes; `--quick` half a minute. The namespaces are the benchmark's own and go with it.
Without them part 2 says why and leaves `tc` out.
"""

import argparse
import json
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from namespaces import INSIDE, how_to_enter, quietly, run_inside, sh

from comms.profiles import LinkProfile
from scenarios.linktest.figures import figures
from scenarios.linktest.real import on_real_clock
from scenarios.linktest.transfer import LinkTest
from scenarios.linktest.virtual import on_virtual_clock

HEADERS_BYTES = 14 + 20 + 8
"""Ethernet, IP, UDP: `tc` counts them, so the link is told to charge as much."""
ENVELOPE_BYTES = 10
"""Of the first 128 frames."""
RATES_BPS = (2400, 3000, 9600, 12_000, 128_000)
PORT = 9999
MTU_BYTES = 1500


@dataclass(frozen=True)
class Case:
    rate_bps: int
    packet_bytes: int
    packets: int

    @property
    def charged_bytes(self) -> int:
        return self.packet_bytes + HEADERS_BYTES

    @property
    def exact_s(self) -> float:
        """From the first packet's arrival to the last one's."""
        return 8 * self.charged_bytes * (self.packets - 1) / self.rate_bps


CASES = (
    Case(2400, 100, 20),
    Case(2400, 200, 12),
    Case(3000, 100, 20),
    Case(9600, 100, 40),
    Case(9600, 200, 20),
    Case(12_000, 200, 20),
    Case(128_000, 200, 100),
    Case(128_000, 1000, 40),
)
QUICK_CASES = (Case(9600, 100, 10), Case(128_000, 200, 50))


# --- the emulated link -----------------------------------------------------------------


def link_test(case: Case) -> LinkTest:
    # A frame's envelope grows by two bytes with its number; room is kept for them.
    frame_bytes = case.packet_bytes + 2
    profile = LinkProfile("any", float(case.rate_bps), 20_000_000, frame_bytes, HEADERS_BYTES)
    return LinkTest(profile, case.packets * (case.packet_bytes - ENVELOPE_BYTES))


def on_virtual(rate_bps: int, frames: int) -> list[str]:
    found = figures(on_virtual_clock(link_test(Case(rate_bps, 100, frames))))
    assert found.measured_bps is not None
    return [
        f"{rate_bps:,}",
        f"{found.measured_bps:,.6f}",
        f"{found.frames:,}",
        f"{1e9 * found.end_late.max_s:.2f} ns",
        f"{1e9 * found.drift_s:,.0f} ns",
    ]


def link_s(case: Case) -> float:
    """Return the seconds from the first arrival to the last over the link, on the wall clock."""
    trial = on_real_clock(link_test(case))
    assert len(trial.heard) == case.packets, (len(trial.heard), case)
    assert {frame.charged_bytes for frame in trial.sent} == {case.charged_bytes}
    heard_ns = [frame.heard_ns for frame in trial.heard]
    return (max(heard_ns) - min(heard_ns)) / 1e9


def on_real(rate_bps: int, packet_bytes: int, frames: int) -> list[str]:
    found = figures(on_real_clock(link_test(Case(rate_bps, packet_bytes, frames))))
    assert found.measured_bps is not None
    late = found.end_late
    words = [1e3 * t_s for t_s in (late.median_s, late.p95_s, late.max_s, found.drift_s)]
    return [
        f"{rate_bps:,}",
        f"{found.measured_bps:,.1f}",
        f"{found.frames:,}",
        *(f"{ms:.2f} ms" for ms in words),
    ]


# --- the kernel's shaper ---------------------------------------------------------------


def shaped_s(cases: list[tuple[Case, int]]) -> list[float | None]:
    """Return the same time for each (case, burst in bytes) through `tc tbf`; None: not all came.

    Runs inside a namespace; makes a second one for the receiving end.
    """
    sh("ip link set lo up")
    command = ["unshare", "-n", sys.executable, __file__, "--receive"]
    receiver = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )
    try:
        assert receiver.stdin is not None
        assert receiver.stdout is not None
        receiver.stdout.readline()  # it is in its namespace
        sh(f"ip link add here type veth peer name there netns {receiver.pid}")
        sh("ip link set here address 02:00:00:00:00:01 addrgenmode none")
        sh("ip addr add 10.9.0.1/24 dev here")
        print("up", file=receiver.stdin)
        receiver.stdout.readline()
        sh("ip link set here up")
        # Known beforehand: nobody's address is asked for on the shaped link.
        sh("ip neigh replace 10.9.0.2 lladdr 02:00:00:00:00:02 dev here nud permanent")
        found: list[float | None] = []
        for case, burst_bytes in cases:
            print(json.dumps(asdict(case)), file=receiver.stdin)
            receiver.stdout.readline()
            shape(case, burst_bytes)
            found.append(json.loads(receiver.stdout.readline()))
        return found
    finally:
        receiver.kill()
        receiver.wait()
        quietly("ip link del here")


def shape(case: Case, burst_bytes: int) -> None:
    """Send a case's packets at once through a fresh shaper."""
    rate = f"rate {case.rate_bps}bit burst {burst_bytes} latency 120s"
    quietly("tc qdisc del dev here root")
    sh(f"tc qdisc add dev here root tbf {rate}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        for _ in range(case.packets):
            out.sendto(bytes(case.packet_bytes), ("10.9.0.2", PORT))


def receive() -> None:
    """Be the receiving end: for each case on standard input, tell the time that it took."""
    print("ready", flush=True)
    sys.stdin.readline()
    sh("ip link set there address 02:00:00:00:00:02 addrgenmode none")
    sh("ip addr add 10.9.0.2/24 dev there")
    sh("ip link set there up")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("10.9.0.2", PORT))
        print("listening", flush=True)
        for line in sys.stdin:
            case = Case(**json.loads(line))
            print("go", flush=True)
            print(json.dumps(first_to_last_s(ear, case)), flush=True)


def first_to_last_s(ear: socket.socket, case: Case) -> float | None:
    ear.settimeout(2.0 * case.exact_s / case.packets + 2.0)
    times_s: list[float] = []
    try:
        while len(times_s) < case.packets:
            ear.recv(2048)
            times_s.append(time.monotonic())
    except TimeoutError:
        return None
    return times_s[-1] - times_s[0]


def inside(cases: list[Case]) -> None:
    wanted = [(case, burst) for case in cases for burst in bursts(case)]
    print(json.dumps(shaped_s(wanted)))


def bursts(case: Case) -> tuple[int, int]:
    """Return what `tbf` may save up: one packet of the interface's MTU, one of these packets.

    The first is the least that lets everything through; the second drops whatever is longer. (A
    burst is kept as a time, in ticks: it may come out a byte less.)
    """
    return MTU_BYTES + 14 + 2, case.charged_bytes + 2


# --- the tables ------------------------------------------------------------------------


def how_to_shape() -> list[str] | str:
    """Return the command that enters a namespace, or the reason why `tc` can't be measured."""
    if shutil.which("tc") is None:
        return "no tc here (iproute2)"
    return how_to_enter()


def through_tbf(cases: Sequence[Case], enter: list[str]) -> list[float | None]:
    """Return seconds from first to last arrival, two for each case: see `bursts`."""
    wanted = json.dumps([asdict(case) for case in cases])
    return json.loads(run_inside(__file__, [wanted], enter))


def side_by_side(cases: Sequence[Case]) -> list[list[str]]:
    enter = how_to_shape()
    if isinstance(enter, str):
        print(f"`tc tbf` is left out: {enter}\n")
        shaped = [None] * (2 * len(cases))
    else:
        shaped = through_tbf(cases, enter)
    rows: list[list[str]] = []
    for index, case in enumerate(cases):
        times_s = [link_s(case), *shaped[2 * index : 2 * index + 2]]
        cells = [against(t_s, case.exact_s) for t_s in times_s]
        packets = f"{case.packets} of {case.packet_bytes}"
        rows.append([f"{case.rate_bps:,}", packets, f"{case.exact_s:.3f} s", *cells])
    return rows


def back_to_back(frames: int) -> list[tuple[int, int, int]]:
    """Return (bps, bytes of a frame, frames) of part 3: fewer where each takes long."""
    fewer, few = frames // 10, max(10, frames // 100)
    return [(128_000, 64, frames), (128_000, 1000, fewer), (9600, 64, fewer), (2400, 64, few)]


def against(took_s: float | None, exact_s: float) -> str:
    if took_s is None:
        return "-"
    error = round(100 * (took_s / exact_s - 1), 1) + 0.0  # no minus before zero
    return f"{took_s:.3f} s ({error:+.1f} %)"


def table(head: list[str], rows: list[list[str]]) -> None:
    print(f"| {' | '.join(head)} |")
    print(f"|{'|'.join(['---:'] * len(head))}|")
    for row in rows:
        print(f"| {' | '.join(row)} |")
    print(flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1000, help="of part 3")
    parser.add_argument("--quick", action="store_true")
    args = parser.parse_args()
    cases = QUICK_CASES if args.quick else CASES
    frames = 200 if args.quick else args.frames

    print("### Virtual clock\n")
    head = ["configured bps", "measured bps", "frames", "latest end", "drift at the last"]
    table(head, [on_virtual(rate, 1000 if args.quick else 10_000) for rate in RATES_BPS])

    print("### Wall clock, beside `tc tbf`: seconds from first to last arrival\n")
    head = ["bps", "packets of bytes", "exact", "ropeteam", "tbf, burst one MTU"]
    table([*head, "tbf, burst one packet"], side_by_side(cases))

    print("### Wall clock, back to back: how late a frame's end is\n")
    head = ["configured bps", "measured bps", "frames", "median", "p95", "max", "drift at the last"]
    table(head, [on_real(*what) for what in back_to_back(frames)])


if __name__ == "__main__":
    if sys.argv[1:2] == [INSIDE]:
        inside([Case(**case) for case in json.loads(sys.argv[2])])
    elif sys.argv[1:2] == ["--receive"]:
        receive()
    else:
        main()

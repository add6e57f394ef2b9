"""What Zenoh, TCP and IP add below the bytes that a link charges.

    python benchmarks/zenoh_overhead.py [--frames 100]

In a network namespace of its own, where nobody else talks, a robot's client sends frames one by one
to the router as in a run, and the router passes them on to one listening client. What crosses the
loopback interface is read off the kernel's own counters (/proc/net/dev) before and after: packets,
and bytes from the IP header on, acknowledgements too. Zenoh's own stream is what is left when each
packet's headers are taken off.
"""

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from namespaces import INSIDE, how_to_enter, run_inside, sh

from comms.air import Packet
from comms.zenoh_air import Channel, Wire, open_client, open_hub

FRAME_BYTES = (64, 128, 256, 1024)
PAUSE_S = 0.05
"""Between frames: on a thin link each leaves alone and is acknowledged alone."""
SETTLE_S = 0.5
HEADERS_BYTES = 20 + 32
"""IP, and TCP with its timestamps. The loopback interface counts no Ethernet headers."""
HOPS = 2
"""Client to router, router to client."""


@dataclass(frozen=True)
class Count:
    """What has crossed the loopback interface."""

    bytes: int
    packets: int

    def __sub__(self, other: "Count") -> "Count":
        return Count(self.bytes - other.bytes, self.packets - other.packets)


def crossed() -> Count:
    lines = Path("/proc/net/dev").read_text().splitlines()
    fields = next(line for line in lines if line.strip().startswith("lo:")).split(":")[1].split()
    return Count(int(fields[0]), int(fields[1]))


def inside(frames: int) -> None:
    """Measure, in a namespace; print a row per frame length as JSON."""
    sh("ip link set lo up")
    hub = open_hub()
    sender, listener = open_client(hub.endpoint), open_client(hub.endpoint)
    try:
        channel = listener.channel("team/**")
        time.sleep(SETTLE_S)
        before = crossed()
        time.sleep(SETTLE_S)
        idle = crossed() - before
        rows = [one_length(sender, channel, length, frames) for length in FRAME_BYTES]
    finally:
        for wire in (sender, listener, hub):
            wire.close()
    print(json.dumps({"idle": idle.bytes, "rows": rows}))


def one_length(sender: Wire, channel: Channel, frame_bytes: int, frames: int) -> dict[str, float]:
    """Send frames of one length; return means per frame."""
    data = bytes(frame_bytes)
    packets = [
        Packet(
            "recon", n, n * 10**9, (n + 1) * 10**9, (("cliffbot", (n + 2) * 10**9),), False, data
        )
        for n in range(1000, 1000 + frames)
    ]
    wires = [packet.to_wire() for packet in packets]
    before = crossed()
    for wire in wires:
        sender.put("team/recon/0", wire)
        time.sleep(PAUSE_S)
    for _ in wires:
        channel.wait()
    time.sleep(SETTLE_S)  # the last acknowledgement
    used = crossed() - before
    return {
        "frame": frame_bytes,
        "packet": sum(map(len, wires)) / frames,
        "stream": (used.bytes - HEADERS_BYTES * used.packets) / frames / HOPS,
        "in_packets": used.bytes / frames / HOPS,
        "packets": used.packets / frames / HOPS,
    }


def measure(frames: int, enter: list[str]) -> dict[str, Any]:
    """Return bytes on an idle loopback, and means per frame and hop for each frame length."""
    return json.loads(run_inside(__file__, [str(frames)], enter))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100)
    args = parser.parse_args()
    enter = how_to_enter()
    if isinstance(enter, str):
        print(f"left out: {enter}")
        return
    found = measure(args.frames, enter)
    print("Bytes per frame and hop, on this computer only; none of it is charged.\n")
    print(
        "| frame | with its times and names | in Zenoh's stream | in IP packets "
        "| packets | added to the frame |"
    )
    print("|---:|---:|---:|---:|---:|---:|")
    for row in found["rows"]:
        added = row["in_packets"] - row["frame"]
        print(
            f"| {row['frame']:.0f} | {row['packet']:.0f} | {row['stream']:.1f} "
            f"| {row['in_packets']:.0f} | {row['packets']:.2f} "
            f"| {added:.0f} ({100 * added / row['frame']:.0f} %) |"
        )
    print(f"\nIdle for {SETTLE_S:g} s: {found['idle']} bytes. {args.frames} frames of each length.")


if __name__ == "__main__":
    if sys.argv[1:2] == [INSIDE]:
        inside(int(sys.argv[2]))
    else:
        main()

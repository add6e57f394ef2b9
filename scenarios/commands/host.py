"""`ropeteam host` and `ropeteam router`: computers for runs that one alone is too small for."""

import argparse
import signal
import threading
import time

from scenarios.commands.parsing import OK, Commands, number, whole
from scenarios.commands.places import add_badge, names_of

EXAMPLES = """\
examples:
  ropeteam host --connect tls/192.168.7.1:7447 --keys keys --name north
  ropeteam run open --set robots.count=32 --hosts north,south \\
      --listen tls/192.168.7.1:7447 --keys keys --name hub
"""
ROUTER = """\
Where robots and computers meet that belong to nobody's run: a Zenoh router with mutual TLS, which
holds each robot to its own keys. `zenohd` with the configuration of docs/security.md does as well.
"""


def add(commands: Commands) -> None:
    """Add the commands."""
    host = commands.add_parser(
        "host",
        help="offer this computer to a run",
        description="Offers this computer to a runner, which starts robots on it.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    host.add_argument("--connect", required=True, metavar="ENDPOINT", help="the runner's router")
    add_badge(host, None)
    host.add_argument("--runs", type=whole, metavar="N", help="serve so many runs, then leave")
    host.set_defaults(run=_host)
    router = commands.add_parser(
        "router", help="be the router at which robots meet", description=ROUTER, allow_abbrev=False
    )
    router.add_argument("--listen", required=True, metavar="ENDPOINT", help="tls/ADDRESS:PORT")
    add_badge(router, "hub")
    router.add_argument("--robots", metavar="A,B", help="certificates that may speak as themselves")
    router.add_argument("--machines", metavar="A,B", help="those of runners and offered computers")
    router.add_argument(
        "--lease",
        type=number,
        default=600.0,
        metavar="S",
        help="after so long a silence somebody counts as gone (600); 10 for real robots",
    )
    router.set_defaults(run=_router)


def _say(text: str) -> None:
    print(text, flush=True)


def _host(args: argparse.Namespace) -> int:
    from scenarios.errors import UsageError
    from scenarios.hosts.endpoints import FIRST_TRY_S, Badge, connected
    from scenarios.hosts.machine import Machine

    badge = Badge(args.keys, args.name)
    credentials = badge.credentials
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    deadline_s = time.monotonic() + FIRST_TRY_S
    while True:
        try:
            wire = connected(args.connect, badge)
            break
        except UsageError:  # the runner may come later than its computers
            if time.monotonic() > deadline_s:
                raise
    try:
        _say(f"{args.name}: offered at {args.connect}")
        Machine(wire, args.name, credentials=credentials, say=_say).serve(args.runs)
    finally:
        wire.close()
    return OK


def _router(args: argparse.Namespace) -> int:
    from scenarios.hosts.endpoints import Badge, listening

    badge = Badge(args.keys, args.name)
    robots, machines = names_of(args.robots), names_of(args.machines)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    lease_ms = max(1000, round(1000 * args.lease))
    wire = listening(args.listen, badge, robots=robots, machines=machines, lease_ms=lease_ms)
    try:
        _say(f"router at {wire.endpoint}")
        threading.Event().wait()
    finally:
        wire.close()
    return OK

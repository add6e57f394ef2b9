"""Options that say where things run: routers, certificates, and computers that are offered."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.errors import UsageError

if TYPE_CHECKING:
    from scenarios.crews.crew import Crew
    from scenarios.schema import Scenario


def add_badge(parser: argparse.ArgumentParser, name: str | None) -> None:
    """Add what says who one is at a router; without `name` it must be given."""
    parser.add_argument(
        "--keys", type=Path, metavar="FOLDER", help="ca.pem, NAME.pem and NAME.key (for tls/...)"
    )
    said = f" ({name})" if name else ""
    parser.add_argument(
        "--name", default=name, required=name is None, help=f"of one's certificate{said}"
    )


def add_places(parser: argparse.ArgumentParser) -> None:
    """Add the options of a run on several computers."""
    parser.add_argument(
        "--hosts", metavar="A,B", help="run the robots on these offered computers (ropeteam host)"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--listen", metavar="ENDPOINT", help="with --hosts: be their router, at tls/ADDRESS:PORT"
    )
    where.add_argument(
        "--connect", metavar="ENDPOINT", help="with --hosts: meet at this router (ropeteam router)"
    )
    add_badge(parser, "runner")


def names_of(text: str | None) -> tuple[str, ...]:
    """Return the names in a list with commas."""
    return tuple(part.strip() for part in (text or "").split(",") if part.strip())


def crew_on_hosts(args: argparse.Namespace, scenario: "Scenario") -> "Callable[[], Crew] | None":
    """Return what makes the crew of a run on offered computers; None: it runs here.

    Raises:
        UsageError: the options don't go together, or not with the scenario.

    """
    hosts = names_of(args.hosts)
    if not hosts:
        if args.listen or args.connect or args.keys:
            raise UsageError("--listen, --connect and --keys are for runs on --hosts A,B")
        return None
    if not (args.listen or args.connect):
        raise UsageError("--hosts needs a router: --listen ENDPOINT, or --connect ENDPOINT")
    if scenario.clock.mode != "virtual" or scenario.air != "zenoh":
        raise UsageError(
            '--hosts: needs the virtual clock and air = "zenoh"; on the wall clock every robot'
            " joins for itself (ropeteam agent)"
        )

    def crew() -> "Crew":
        from scenarios.hosts.crew import HostedCrew
        from scenarios.hosts.endpoints import Badge, connected, listening

        badge = Badge(args.keys, args.name)
        if args.listen:
            return HostedCrew(listening(args.listen, badge, machines=hosts), hosts)
        return HostedCrew(connected(args.connect, badge), hosts)

    return crew

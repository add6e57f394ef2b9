"""`ropeteam link test`: what to know of a link before trusting it."""

import argparse
import json
from typing import TYPE_CHECKING, Any

from scenarios.commands.parsing import OK, Commands, Parser, number, whole

if TYPE_CHECKING:
    from comms.profiles import LinkProfile
    from scenarios.linktest.transfer import LinkTest, Trial

EXAMPLES = """\
examples:
  ropeteam link test --profile sojourner --bytes 10000
  ropeteam link test --profile orbiter --rate-bps 64000 --loss 0.05
  ropeteam link test --profile mer-low --set jitter_s=0.5 --set burst_s=2
  ropeteam link test --profile orbiter --clock real    two processes, Zenoh between them
"""
_TEST_HELP = """\
Sends bytes in frames over an emulated link, as robots do, and tells what came of it: the rate that
was configured and the one that was measured, when frames ended and arrived, what envelope and
overhead cost, what was lost. Nothing is sent again. On the virtual clock instants are exact; on the
real clock two processes talk over Zenoh's loopback, and the test takes as long as it says.
"""


def add(commands: Commands) -> None:
    """Add the command."""
    link = commands.add_parser("link", help="test an emulated link", allow_abbrev=False)
    actions = link.add_subparsers(
        title="actions", dest="action", metavar="ACTION", required=True, parser_class=Parser
    )
    test = actions.add_parser(
        "test",
        help="send bytes over it, and measure",
        description=_TEST_HELP,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    test.add_argument("--profile", metavar="NAME", help="the radio (uhf-9600)")
    test.add_argument("--bytes", type=whole, default=10_000, metavar="N", help="to send (10000)")
    test.add_argument("--rate-bps", type=number, metavar="R", help="another rate on air")
    test.add_argument("--loss", type=number, metavar="P", help="probability that a frame is lost")
    test.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="sets",
        help="any key of a scenario's [links], e.g. jitter_s=0.5; may be repeated",
    )
    test.add_argument(
        "--clock",
        choices=("virtual", "real"),
        default="virtual",
        help="exact, at once; or as this computer keeps time",
    )
    test.add_argument("--seed", type=whole, default=1, metavar="N", help="of loss and jitter (1)")
    test.add_argument("--json", action="store_true", help="print the figures as JSON")
    test.set_defaults(run=_test)


def _test(args: argparse.Namespace) -> int:
    from scenarios.linktest.figures import figures
    from scenarios.linktest.transfer import LinkTest

    test = LinkTest(_profile(args), args.bytes, args.seed)
    test.check()
    found = figures(_trial(test, args))
    if args.json:
        from dataclasses import asdict

        print(json.dumps({"profile": test.profile.name, "clock": args.clock} | asdict(found)))
    else:
        from scenarios.linktest.page import show

        show(test, args.clock, found, _said(args))
    return OK


def _said(args: argparse.Namespace) -> str:
    return f"with {', '.join(args.sets)}" if args.sets else ""


def _trial(test: "LinkTest", args: argparse.Namespace) -> "Trial":
    if args.clock == "virtual":
        from scenarios.linktest.virtual import on_virtual_clock

        return on_virtual_clock(test)
    from rich.console import Console

    from scenarios.linktest.real import on_real_clock

    with Console(stderr=True).status(f"sending: about {test.about_s():,.0f} s"):
        return on_real_clock(test)


def _profile(args: argparse.Namespace) -> "LinkProfile":
    """Return the link that the options ask for, by the rules of a scenario's [links]."""
    from pydantic import ValidationError

    from comms.linksettings import AllLinks, TeamLinks
    from comms.profiles import resolve
    from scenarios.errors import ScenarioError
    from scenarios.schema.problems import sentences

    options, settings = _settings(args)
    try:
        checked = AllLinks.model_validate(settings)
    except ValidationError as error:
        raise ScenarioError(
            sentences(error, AllLinks, lambda key: options[key.split(".")[0]])
        ) from error
    links = TeamLinks(**checked.model_dump(exclude_unset=True))
    return resolve(links, "here", "there")


def _settings(args: argparse.Namespace) -> tuple[dict[str, str], dict[str, Any]]:
    """Return (the option that said so, the value) by key; what is said last counts."""
    from scenarios.errors import UsageError
    from scenarios.schema.overrides import parse_override

    options: dict[str, str] = {}
    settings: dict[str, Any] = {}
    for key in ("profile", "rate_bps", "loss"):
        value = getattr(args, key)
        if value is not None:
            options[key], settings[key] = f"--{key.replace('_', '-')} {value}", value
    for text in args.sets:
        change = parse_override(text)
        if len(change.path) != 1:
            raise UsageError(f"{change.option}: must be a key of [links], e.g. jitter_s=0.5")
        options[change.key], settings[change.key] = change.option, change.value
    return options, settings

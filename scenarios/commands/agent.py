"""`ropeteam agent`: one robot by itself, on its own computer and the real clock."""

import argparse
from pathlib import Path

from scenarios.commands.parsing import OK, Commands

_HELP = """\
Runs one robot on the real clock until Ctrl-C: what it has for a body is the driver's affair that
its settings name (docs/hosts.md), and it meets its team at a Zenoh router.
"""


def add(commands: Commands) -> None:
    """Add the command."""
    agent = commands.add_parser(
        "agent", help="run one robot by itself", description=_HELP, allow_abbrev=False
    )
    agent.add_argument("--settings", type=Path, required=True, metavar="FILE", help="its TOML file")
    agent.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from comms.errors import CommsError
    from comms.zenoh_security import Credentials, check_endpoint
    from scenarios.agent.hardware import Mount, driver_of
    from scenarios.agent.life import Agent
    from scenarios.agent.settings import read_agent_file
    from scenarios.errors import ScenarioError
    from sim.errors import WorldError

    file, key = read_agent_file(args.settings)
    driver = driver_of(file.hardware.driver)
    try:
        check_endpoint(file.router.endpoint, with_credentials=bool(file.router.keys))
        if file.router.keys:
            Credentials.of(Path(file.router.keys), file.name)
        hardware = driver(Mount(file, args.settings.absolute().parent))
    except (CommsError, WorldError) as error:
        raise ScenarioError([f"{args.settings}: {error}"]) from error
    Agent(file, key, hardware).run()
    return OK

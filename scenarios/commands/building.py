"""`ropeteam new`, `ropeteam schema` and `ropeteam completion`: for those who build on it."""

import argparse
import sys
from pathlib import Path

from scenarios.commands.parsing import OK, Commands


def add(commands: Commands) -> None:
    """Add the commands."""
    new = commands.add_parser(
        "new",
        help="begin a study of your own",
        description="Makes a folder with a strategy of your own (a package with one file), a"
        " scenario that uses it, and a study that sets it beside others.",
    )
    new.add_argument("folder", metavar="NAME", help="a new folder; the study is called after it")
    new.set_defaults(run=_new)
    schema = commands.add_parser(
        "schema",
        help="JSON Schema of scenario or study files, for editors",
        description="Writes the JSON Schema of scenario or study files, with the parts that"
        " installed packages bring. A file names it in its first line: #:schema FILE",
    )
    schema.add_argument("of", choices=("scenario", "study"), help="which files")
    schema.add_argument("--out", metavar="FILE", help="write it there (else: print it)")
    schema.set_defaults(run=_schema)
    completion = commands.add_parser(
        "completion",
        help="completion of commands and options in your shell",
        description='Prints what makes a shell complete ropeteam; for bash: eval "$(ropeteam'
        ' completion bash)" in ~/.bashrc.',
    )
    completion.add_argument("shell", choices=("bash", "zsh", "tcsh"))
    completion.set_defaults(run=_completion)


def _new(args: argparse.Namespace) -> int:
    from scenarios.starting import start

    folder = Path(args.folder)
    for path in start(folder):
        print(path)
    print(f"Next: cd {folder} && pip install -e . && ropeteam run scenario.toml")
    return OK


def _schema(args: argparse.Namespace) -> int:
    from scenarios.errors import UsageError
    from scenarios.jsonschema import scenario_schema, study_schema, text

    content = text(scenario_schema(installed=True) if args.of == "scenario" else study_schema())
    if args.out is None:
        sys.stdout.write(content)
        return OK
    try:
        Path(args.out).write_text(content, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"--out {args.out}: can't be written: {error.strerror}") from error
    return OK


def _completion(args: argparse.Namespace) -> int:
    import shtab

    from scenarios.cli import make_parser

    print(shtab.complete(make_parser(), shell=args.shell))
    return OK

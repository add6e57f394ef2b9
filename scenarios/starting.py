"""`ropeteam new`: a folder to begin a study in, with a strategy of its own."""

import keyword
import re
from pathlib import Path

from scenarios.errors import FolderError, UsageError
from scenarios.jsonschema import SCHEMAS, text

TEMPLATE = Path(__file__).parent / "template"
NAME_RULE = r"[a-z][a-z0-9-]{0,31}"


def start(folder: Path) -> list[Path]:
    """Fill a new or empty folder, named as the study shall be; return the files.

    Raises:
        UsageError: its name is none for a study.
        FolderError: it holds something, or can't be written to.

    """
    name = folder.absolute().name
    if not re.fullmatch(NAME_RULE, name) or name.endswith("-"):
        raise UsageError(
            f"{name}: is no name for a study; needed are small letters, digits and '-', at most"
            " 32, a letter first"
        )
    module = name.replace("-", "_")
    if keyword.iskeyword(module) or module in ("agents", "comms", "sim", "scenarios"):
        raise UsageError(f"{name}: is taken by Python or by ropeteam itself; choose another name")
    texts = {
        path.name.replace("strategy.py", f"{module}.py"): path.read_text(encoding="utf-8")
        .replace("NAME", name)
        .replace("MODULE", module)
        for path in sorted(TEMPLATE.iterdir())
        if path.is_file()
    }
    for kind, make in SCHEMAS.items():
        texts[f"{kind}.schema.json"] = text(make())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise FolderError(f"{folder}: holds files; must be new or empty")
        for file, content in texts.items():
            (folder / file).write_text(content, encoding="utf-8")
    except OSError as error:
        raise FolderError(f"{folder}: can't be written to: {error.strerror}") from error
    return [folder / file for file in texts]

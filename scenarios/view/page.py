"""The page itself, as one file: the same scripts live and afterwards, and nothing from outside."""

import base64
import gzip
import html
import json
from functools import cache
from importlib.resources import files
from typing import Any

from scenarios.view.pack import pack

MODULES = (
    "data",
    "model",
    "shade",
    "panel",
    "scene",
    "charts",
    "tables",
    "links",
    "curves",
    "keys",
    "looks",
    "controls",
)
"""Scripts that the pages are made of; they import each other as "ropeteam/NAME"."""
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; "
    "img-src data: blob:; base-uri 'none'; form-action 'none'"
)
"""What a page may load: nothing but itself."""


@cache
def asset(name: str) -> str:
    """Return a file of the page's."""
    return (files("scenarios.view") / "assets" / name).read_text(encoding="utf-8")


def self_contained(title: str, entry: str, data: Any) -> str:
    """Return one HTML file with all that it needs.

    Args:
        title: of the page.
        entry: the script that begins, e.g. "report".
        data: what it shows (see `scenarios.view.pack`).

    """
    packed = gzip.compress(pack(data), compresslevel=7, mtime=0)
    urls = {f"ropeteam/{name}": _script_url(asset(f"{name}.js")) for name in MODULES}
    return "".join(
        (
            *_opening(title, f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'),
            f"<style>{asset('uPlot.min.css')}\n{asset('page.css')}</style>\n",
            f'<script type="importmap">{json.dumps({"imports": urls})}</script>\n',
            f"<script>{asset('uPlot.iife.min.js')}</script>\n",
            "</head>\n<body>\n<div id=page></div>\n",
            "<noscript>This page needs JavaScript.</noscript>\n",
            '<script type="text/plain" id="data">',
            base64.b64encode(packed).decode(),
            "</script>\n",
            f'<script type="module">{asset(f"{entry}.js")}</script>\n',
            "</body>\n</html>\n",
        )
    )


def served(title: str) -> str:
    """Return the page of a run that goes on; its scripts come from the runner."""
    urls = {f"ropeteam/{name}": f"./{name}.js" for name in MODULES}
    return "".join(
        (
            *_opening(title, ""),
            '<link rel="stylesheet" href="./uPlot.min.css">\n',
            '<link rel="stylesheet" href="./page.css">\n',
            f'<script type="importmap">{json.dumps({"imports": urls})}</script>\n',
            '<script src="./uPlot.iife.min.js"></script>\n',
            "</head>\n<body>\n<div id=page></div>\n",
            '<script type="module" src="./live.js"></script>\n',
            "</body>\n</html>\n",
        )
    )


def _opening(title: str, more: str) -> tuple[str, ...]:
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
        more,
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
        '<meta name="color-scheme" content="light dark">\n',
        '<link rel="icon" href="data:,">\n',
        f"<title>{html.escape(title)}</title>\n",
    )


def _script_url(text: str) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"

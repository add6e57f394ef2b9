"""The reader's screen: whether there is one, and a page in its browser."""

import os
import sys
import webbrowser


def open_page(url: str) -> bool:
    """Open a page in a window of the browser; say whether there is one.

    A browser in the terminal would take it from the run.
    """
    return bool(has_window() or os.environ.get("BROWSER")) and webbrowser.open(url)


def has_window() -> bool:
    """Say whether a program could open a window here."""
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return named or not sys.platform.startswith("linux")

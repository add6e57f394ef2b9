"""The reader's browser."""

import os
import sys
import webbrowser


def open_page(url: str) -> bool:
    """Open a page in a window of the browser; say whether there is one.

    A browser in the terminal would take it from the run.
    """
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
    return (named or not sys.platform.startswith("linux")) and webbrowser.open(url)

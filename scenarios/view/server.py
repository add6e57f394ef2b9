"""Serves the page of a run from loopback, in a thread of its own; it never touches the run.

Whoever may open the page may end robots. So it listens on loopback only, under a path that nobody
can guess, and takes no word from the page of another origin.
"""

import asyncio
import json
import secrets
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, cast

from tornado.httpserver import HTTPServer
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from scenarios.errors import UsageError
from scenarios.view.pack import pack
from scenarios.view.page import MODULES, POLICY, asset, served

HOST = "127.0.0.1"
START_S = 10.0
"""Wall seconds that the server may take to start."""
DRAIN_S = 5.0
"""Wall seconds that pages have to take the last of what is told."""
MOST_SAID_BYTES = 4096
"""Longer words from a page are not taken."""
_TYPES = {"js": "text/javascript; charset=utf-8", "css": "text/css; charset=utf-8"}
_ASSETS = (*(f"{name}.js" for name in (*MODULES, "live")), "page.css", "uPlot.min.css",
           "uPlot.iife.min.js")  # fmt: skip
_POLICY = POLICY.replace("script-src", "script-src 'self'").replace("style-src", "style-src 'self'")


class Server:
    """One page, for one run."""

    def __init__(self, title: str, head: dict[str, Any], ask: Callable[[Any], None]) -> None:
        """Serve a run of a title, with a head (`scenarios.view.reel`); `ask` takes wishes."""
        self._title = title
        self._ask = ask
        self._told: list[bytes] = [pack({"type": "head", "head": head})]
        self._state = b""
        self._pages: dict[_Socket, None] = {}
        self._key = secrets.token_urlsafe(9)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._serve, name="page", daemon=True)
        self._began = threading.Event()
        self.watched = threading.Event()
        """Set once somebody has opened the page."""
        self._http: HTTPServer | None = None
        self.address = ""

    def start(self, port: int = 0) -> None:
        """Begin to serve; 0 takes any free port.

        Raises:
            UsageError: the port is taken.

        """
        self._socket = _listening(port)
        self.address = f"http://{HOST}:{self._socket.getsockname()[1]}/{self._key}/"
        self._loop = asyncio.new_event_loop()
        self._thread.start()
        assert self._began.wait(START_S), "the page's server did not start"

    def tell(self, told: dict[str, Any]) -> None:
        """Show something on all pages, and on those that come later; from any thread."""
        assert self._loop is not None
        data = pack(told)
        self._loop.call_soon_threadsafe(self._spread, data, told["type"])

    def stop(self) -> None:
        """End, once all pages have taken what was told, or have had time to."""
        if self._loop is None or not self._thread.is_alive():
            return
        done = asyncio.run_coroutine_threadsafe(self._drain(), self._loop)
        try:
            done.result(2 * DRAIN_S)
        finally:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(START_S)

    # --- in the server's thread ------------------------------------------------------------

    def _serve(self) -> None:
        assert self._loop is not None
        asyncio.set_event_loop(self._loop)
        self._loop.call_soon(self._begin)
        self._loop.run_forever()
        self._loop.close()

    def _begin(self) -> None:
        routes: list[Any] = [
            (rf"/{self._key}/socket", _Socket, {"server": self}),
            (rf"/{self._key}/([A-Za-z.]*)", _File, {"title": self._title}),
        ]
        application = Application(routes, log_function=_no_log)
        self._http = http = HTTPServer(application)
        http.add_sockets([self._socket])
        self._began.set()

    def _spread(self, data: bytes, kind: str) -> None:
        if kind == "state":
            self._state = data
        elif kind in ("rows", "end"):
            self._told.append(data)
        for page in self._pages:
            page.tell(data)

    def join(self, page: "_Socket") -> None:
        """Show a page all that was told so far."""
        for data in self._told:
            page.tell(data)
        if self._state:
            page.tell(self._state)
        self._pages[page] = None
        self.watched.set()

    def leave(self, page: "_Socket") -> None:
        """Forget a page."""
        self._pages.pop(page, None)

    def ask(self, wish: Any) -> None:
        """Pass a wish on."""
        self._ask(wish)

    async def _drain(self) -> None:
        for page in list(self._pages):
            page.close(1000, "the run is over")
        deadline_s = time.monotonic() + DRAIN_S
        while self._pages and time.monotonic() < deadline_s:
            await asyncio.sleep(0.02)
        if self._http is not None:
            self._http.stop()
            await self._http.close_all_connections()


def _no_log(handler: RequestHandler) -> None:
    """Write no line for each request."""


def _listening(port: int) -> socket.socket:
    """Return a socket that listens on loopback.

    Raises:
        UsageError: the port is taken.

    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((HOST, port))
        listening.listen()
    except OSError as error:
        listening.close()
        said = f"--port {port}: {error.strerror}; must be a free port, or left out for any"
        raise UsageError(said) from error
    listening.setblocking(False)
    return listening


class _Ours(RequestHandler):
    """Answers those only who call this computer by its own name.

    Another name may be a trick: a foreign page whose name has come to mean this computer.
    """

    def prepare(self) -> None:
        """Refuse a request that names another computer."""
        if self.request.host.partition(":")[0] not in (HOST, "localhost"):
            raise HTTPError(403)


class _File(_Ours):
    """The page and its scripts."""

    def initialize(self, title: str) -> None:
        """Take what the page is called."""
        self._title = title

    def get(self, name: str) -> None:
        """Send a file."""
        if name and name not in _ASSETS:
            self.send_error(404)
            return
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        if name:
            self.set_header("Content-Type", _TYPES[name.rpartition(".")[2]])
            self.write(asset(name))
        else:
            self.set_header("Content-Security-Policy", f"{_POLICY}; connect-src 'self'")
            self.write(served(self._title))


class _Socket(_Ours, WebSocketHandler):
    """What one open page is told, and what it asks for."""

    def initialize(self, server: Server) -> None:
        """Belong to a server."""
        self._server = server

    def open(self, *_: str, **__: str) -> None:
        """Show a page that was just opened all that there is."""
        self._server.join(self)

    def on_message(self, message: str | bytes) -> None:
        """Take a wish."""
        if len(message) > MOST_SAID_BYTES:
            return
        try:
            wish = cast("object", json.loads(message))
        except ValueError:
            return
        if isinstance(wish, dict):
            self._server.ask(wish)

    def on_close(self) -> None:
        """Go."""
        self._server.leave(self)

    def tell(self, data: bytes) -> None:
        """Send something."""
        try:
            self.write_message(data, binary=True)
        except WebSocketClosedError:
            self._server.leave(self)

"""A headless Chromium that looks at a page: for the pictures in the documents, and for tests.

It is driven over its own debugging protocol (chromedevtools.github.io/devtools-protocol), through
a websocket on loopback.
"""

import asyncio
import base64
import json
import shutil
import subprocess
import tempfile
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from itertools import count
from pathlib import Path
from typing import Any

from tornado.httpclient import AsyncHTTPClient
from tornado.websocket import WebSocketClientConnection, websocket_connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
START_S = 60.0
"""Wall seconds that a browser may take to start."""
ANSWER_S = 60.0
"""Wall seconds that a browser may take to answer."""
_MOST_BYTES = 256 * 2**20


class BrowserError(Exception):
    """The browser did not start, or could not do what was asked."""


def find_browser() -> str | None:
    """Return the program of an installed browser, or None."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Tab:
    """One page in the browser."""

    def __init__(self, socket: WebSocketClientConnection) -> None:
        """Talk to a page over its socket."""
        self._socket = socket
        self._numbers = count(1)
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self.complaints: list[str] = []
        """What the page wrote to the console as a warning or error, and what it failed to load."""

    async def listen(self) -> None:
        """Take what the page says, until its socket closes."""
        while (text := await self._socket.read_message()) is not None:
            message = json.loads(text)
            waiting = self._answers.pop(message.get("id", 0), None)
            if waiting is not None and not waiting.done():
                waiting.set_result(message)
            self._hear(message.get("method", ""), message.get("params", {}))

    def _hear(self, method: str, told: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            thrown = details.get("exception", {}).get("description", "")
            self.complaints.append(f"{details['text']} {thrown}")
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning"):
            words = [str(arg.get("value", arg.get("description", ""))) for arg in told["args"]]
            self.complaints.append(" ".join(words))
        elif method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.complaints.append(told["entry"]["text"])

    async def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Have the browser do something; return its answer.

        Raises:
            BrowserError: it refused, or gave no answer.

        """
        number = next(self._numbers)
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers[number] = answer
        await self._socket.write_message(
            json.dumps({"id": number, "method": method, "params": params})
        )
        try:
            message = await asyncio.wait_for(answer, ANSWER_S)
        except TimeoutError as error:
            raise BrowserError(f"{method}: no answer") from error
        if "error" in message:
            raise BrowserError(f"{method}: {message['error']['message']}")
        return message["result"]

    async def open(self, url: str) -> None:
        """Go to a page."""
        for part in ("Page", "Runtime", "Log"):
            await self.ask(f"{part}.enable")
        await self.ask("Page.navigate", url=url)

    async def size(
        self, width: int, height: int, *, dark: bool = False, phone: bool = False
    ) -> None:
        """Set the size of the page in CSS pixels, and whether its user likes it dark."""
        await self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=2 if phone else 1,
            mobile=phone,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        await self.ask("Emulation.setEmulatedMedia", features=[scheme])

    async def value(self, expression: str) -> Any:
        """Return what a JavaScript expression gives (a promise is awaited).

        Raises:
            BrowserError: it throws.

        """
        told = await self.ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in told:
            raise BrowserError(told["exceptionDetails"]["exception"].get("description", expression))
        return told["result"].get("value")

    async def until(self, expression: str, within_s: float = ANSWER_S) -> None:
        """Wait until a JavaScript expression holds.

        Raises:
            BrowserError: it does not, for so long.

        """
        deadline_s = asyncio.get_running_loop().time() + within_s
        while not await self.value(f"Boolean({expression})"):
            if asyncio.get_running_loop().time() > deadline_s:
                raise BrowserError(f"never held: {expression}; the page said {self.complaints}")
            await asyncio.sleep(0.1)

    async def key(self, key: str, text: str = "") -> None:
        """Press a key and let it go."""
        await self.ask("Input.dispatchKeyEvent", type="keyDown", key=key, code=key, text=text)
        await self.ask("Input.dispatchKeyEvent", type="keyUp", key=key, code=key)

    async def picture(self, path: Path, *, whole: bool = False) -> None:
        """Write what is seen of the page, or all of it, as a PNG."""
        told = await self.ask("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(told["data"]))


@asynccontextmanager
async def browser(program: str) -> AsyncGenerator[Tab]:
    """Start a browser without a window, with one empty page; end it afterwards.

    Raises:
        BrowserError: it does not start.

    """
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        # No sandbox: it does not start as root, and it opens nothing but our own pages.
        command = [
            program, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
            "--no-first-run", "--disable-extensions", "--disable-background-networking",
            "--disable-component-update", "--hide-scrollbars", "--remote-debugging-port=0",
            f"--user-data-dir={folder}", "about:blank",
        ]  # fmt: skip
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
        try:
            url = await _page_url(Path(folder) / "DevToolsActivePort", process)
            socket = await websocket_connect(url, max_message_size=_MOST_BYTES)
            tab = Tab(socket)
            listening = asyncio.create_task(tab.listen())
            try:
                yield tab
            finally:
                socket.close()
                await listening
        finally:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


async def _page_url(told: Path, process: subprocess.Popen[bytes]) -> str:
    """Return the address of the first page's socket, once the browser has one."""
    deadline_s = asyncio.get_running_loop().time() + START_S
    while asyncio.get_running_loop().time() < deadline_s:
        if process.poll() is not None:
            raise BrowserError(f"the browser ended at once (exit code {process.returncode})")
        await asyncio.sleep(0.1)
        lines = told.read_text().splitlines() if told.is_file() else []
        if len(lines) < 2:
            continue
        answer = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{lines[0]}/json/list")
        pages = [page for page in json.loads(answer.body) if page["type"] == "page"]
        if pages:
            return str(pages[0]["webSocketDebuggerUrl"])
    raise BrowserError(f"the browser was not there after {START_S:g} s")

"""The page is for this computer's own browser, and for nobody who can't know its address."""

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from scenarios.errors import UsageError
from scenarios.view.pack import unpack
from scenarios.view.server import MOST_SAID_BYTES, Server

HEAD = {"title": "x"}


class Asked(list[Any]):
    pass


@pytest.fixture
def asked() -> Asked:
    return Asked()


@pytest.fixture
def server(asked: Asked) -> Iterator[Server]:
    server = Server("A <run>", HEAD, asked.append)
    server.start()
    yield server
    server.stop()


@pytest.fixture
async def socket(server: Server) -> AsyncIterator[WebSocketClientConnection]:
    socket = await connect(server)
    yield socket
    socket.close()


async def connect(server: Server, **headers: str) -> WebSocketClientConnection:
    url = server.address.replace("http", "ws") + "socket"
    return await websocket_connect(HTTPRequest(url, headers=headers))


async def hear(socket: WebSocketClientConnection) -> Any:
    data = await asyncio.wait_for(socket.read_message(), 10)
    return unpack(data) if isinstance(data, bytes) else data


async def get(url: str, **headers: str) -> Any:
    return await AsyncHTTPClient().fetch(HTTPRequest(url, headers=headers))


async def test_the_page_and_its_scripts_are_served(server: Server) -> None:
    page = await get(server.address)
    assert b"A &lt;run&gt;" in page.body
    assert "default-src 'none'" in page.headers["Content-Security-Policy"]
    script = await get(server.address + "live.js")
    assert b"WebSocket" in script.body
    assert script.headers["Content-Type"].startswith("text/javascript")


@pytest.mark.parametrize("name", ["nothing.js", "page.py", "%2e%2e/page.py", "..%2fpage.py"])
async def test_nothing_else_is_served(name: str, server: Server) -> None:
    with pytest.raises(HTTPClientError, match="404"):
        await get(server.address + name)


async def test_without_its_key_nothing_is_served(server: Server) -> None:
    root = server.address.rsplit("/", 2)[0]
    with pytest.raises(HTTPClientError, match="404"):
        await get(root + "/")


async def test_another_name_for_this_computer_is_refused(server: Server) -> None:
    with pytest.raises(HTTPClientError, match="403"):
        await get(server.address, Host="evil.example")
    with pytest.raises(HTTPClientError, match="403"):
        await connect(server, Host="evil.example", Origin="http://evil.example")


async def test_the_page_of_another_origin_is_refused(server: Server) -> None:
    with pytest.raises(HTTPClientError, match="403"):
        await connect(server, Origin="http://evil.example")


async def test_who_comes_late_is_told_all(server: Server) -> None:
    server.tell({"type": "rows", "now_s": 1.0, "rows": {"moves": [b"\x01"]}})
    server.tell({"type": "state", "paused": False})
    server.tell({"type": "state", "paused": True})
    socket = await connect(server)
    told = [await hear(socket) for _ in range(3)]
    watched = await asyncio.to_thread(server.watched.wait, 20)  # set when all that was told
    socket.close()
    assert [t["type"] for t in told] == ["head", "rows", "state"]
    assert told[0]["head"] == HEAD
    assert told[1]["rows"] == {"moves": [b"\x01"]}
    assert told[2]["paused"] is True
    assert watched


async def test_wishes_are_passed_on_and_nonsense_is_not(
    server: Server, socket: WebSocketClientConnection, asked: Asked
) -> None:
    assert (await hear(socket))["type"] == "head"
    for words in ("{", "[]", '"kill"', json.dumps({"do": "x" * MOST_SAID_BYTES})):
        await socket.write_message(words)
    await socket.write_message(b"\xff\xfe", binary=True)
    await socket.write_message(json.dumps({"do": "pause"}))
    for _ in range(100):
        if asked:
            break
        await asyncio.sleep(0.05)
    assert asked == [{"do": "pause"}]


async def test_the_last_word_reaches_the_page(
    server: Server, socket: WebSocketClientConnection
) -> None:
    assert (await hear(socket))["type"] == "head"
    server.tell({"type": "end", "end": {"x": 1}})
    stopping = asyncio.get_running_loop().run_in_executor(None, server.stop)
    assert (await hear(socket))["end"] == {"x": 1}
    assert await hear(socket) is None
    await stopping


def test_a_port_that_is_taken_is_refused_in_a_sentence(server: Server) -> None:
    port = int(server.address.split(":")[2].split("/")[0])
    other = Server("other", HEAD, print)
    with pytest.raises(UsageError, match=f"--port {port}: Address already in use"):
        other.start(port)
    other.stop()

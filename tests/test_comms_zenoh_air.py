"""What one process puts comes to the others, whole and in order, on the loop that listens."""

import asyncio
from collections.abc import Iterator

import pytest

from comms.zenoh_air import TransportError, Wire, open_client, open_hub

MANY = 2000


@pytest.fixture
def hub() -> Iterator[Wire]:
    wire = open_hub()
    yield wire
    wire.close()


@pytest.fixture
def client(hub: Wire) -> Iterator[Wire]:
    wire = open_client(hub.endpoint)
    yield wire
    wire.close()


def test_a_channel_gives_all_that_was_put_in_order(hub: Wire, client: Wire) -> None:
    channel = hub.channel("team/**")
    for number in range(MANY):
        client.put("team/recon/0", b"%d" % number)
    assert [channel.wait() for _ in range(MANY)] == [
        ("team/recon/0", b"%d" % number) for number in range(MANY)
    ]
    assert channel.poll() is None


async def test_messages_that_cannot_be_taken_hold_up_none_behind_them(
    hub: Wire, client: Wire
) -> None:
    loop = asyncio.get_running_loop()
    failed: list[str] = []
    loop.set_exception_handler(lambda _, context: failed.append(str(context["exception"])))
    taken: list[int] = []
    done = asyncio.Event()

    def handle(key: str, data: bytes) -> None:
        del key
        number = int(data)
        if number % 7 == 0:
            raise ValueError(f"no {number}")
        taken.append(number)
        if number == MANY:
            done.set()

    hub.listen("team/**", handle, loop.call_soon_threadsafe)
    for number in range(1, MANY + 1):
        client.put("team/recon/0", b"%d" % number)
    await asyncio.wait_for(done.wait(), 20)
    assert taken == [number for number in range(1, MANY + 1) if number % 7]
    assert failed == [f"no {number}" for number in range(7, MANY + 1, 7)]


def test_a_client_without_a_hub_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("comms.zenoh_air.CONNECT_MS", 200)
    with pytest.raises(TransportError, match=r"no hub answers at tcp/127\.0\.0\.1:1:"):
        open_client("tcp/127.0.0.1:1")

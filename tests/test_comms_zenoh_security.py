"""Nobody gets in without a certificate; whoever is in says only what is his own to say."""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from comms import zenoh_air
from comms.zenoh_air import (
    Channel,
    TransportError,
    Wire,
    hub_config,
    open_client,
    open_hub,
)
from comms.zenoh_security import (
    LOOPBACK,
    Credentials,
    SecurityError,
    access_control,
    check_endpoint,
)

PAGE = Path(__file__).parents[1] / "docs" / "security.md"
ROBOTS = ("recon", "cliffbot")
TLS = "tls/127.0.0.1:0"
LEASE_MS = 600_000


def block(language: str) -> str:
    """Return the page's block of code of a language."""
    return PAGE.read_text().split(f"```{language}\n", 1)[1].split("```", 1)[0]


def make_keys(folder: Path) -> Path:
    """Do what the page says, and make a certificate for somebody who is not of the team."""
    if shutil.which("openssl") is None:
        pytest.skip("there is no openssl command to make certificates with")
    folder.mkdir()
    script = block("sh") + '\ncertify visitor clientAuth "DNS:visitor"\n'
    subprocess.run(["sh", "-ec", script], cwd=folder, check=True, capture_output=True)
    return folder / "keys"


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_keys(tmp_path_factory.mktemp("certificates") / "ours")


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_keys(tmp_path_factory.mktemp("certificates") / "others")


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    """Close what is pushed here in the end, or the test never ends."""
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh_air, "CONNECT_MS", 500)


def closed_later(stack: ExitStack, wire: Wire) -> Wire:
    stack.callback(wire.close)
    return wire


def secure_hub(stack: ExitStack, folder: Path, name: str = "hub") -> Wire:
    credentials = Credentials.of(folder, name)
    return closed_later(stack, open_hub(listen=TLS, credentials=credentials, robots=ROBOTS))


def robot(stack: ExitStack, hub: Wire, folder: Path, name: str) -> Wire:
    return closed_later(stack, open_client(hub.endpoint, credentials=Credentials.of(folder, name)))


def heard(channel: Channel) -> list[tuple[str, bytes]]:
    messages: list[tuple[str, bytes]] = []
    while (message := channel.poll()) is not None:
        messages.append(message)
    return messages


# --- who gets in --------------------------------------------------------------------------------


@pytest.mark.usefixtures("impatient")
def test_without_a_certificate_of_the_team_nobody_gets_in(
    keys: Path, others: Path, opened: ExitStack
) -> None:
    hub = secure_hub(opened, keys)
    with pytest.raises(TransportError, match="no hub answers"):
        open_client(hub.endpoint, credentials=Credentials.of(others, "recon"))
    with pytest.raises(TransportError, match="no hub answers"):
        open_client(hub.endpoint.replace("tls/", "tcp/"))
    with pytest.raises(TransportError, match="no hub answers"):
        nameless_client(hub.endpoint, keys)
    robot(opened, hub, keys, "recon")  # it was not for lack of a hub


def nameless_client(endpoint: str, keys: Path) -> Wire:
    """Connect as one who knows the authority, but has no certificate."""
    config = zenoh_air.client_config(LEASE_MS, endpoint, Credentials.of(keys, "recon"))
    tls = config["transport"]["link"]["tls"]
    for what in ("connect_certificate", "connect_private_key"):
        del tls[what]
    try:
        return Wire(zenoh_air.open_session(config), endpoint)
    except zenoh_air.zenoh.ZError as error:
        raise TransportError(f"no hub answers: {error}") from error


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(("whose", "name"), [("others", "hub"), ("ours", "cliffbot")])
def test_no_robot_connects_to_a_hub_that_is_not_the_teams(
    keys: Path, others: Path, opened: ExitStack, whose: str, name: str
) -> None:
    false_hub = secure_hub(opened, keys if whose == "ours" else others, name)
    with pytest.raises(TransportError, match="no hub answers"):
        open_client(false_hub.endpoint, credentials=Credentials.of(keys, "recon"))


# --- who says what ------------------------------------------------------------------------------


def test_a_robot_is_heard_on_its_own_keys_and_on_no_others(keys: Path, opened: ExitStack) -> None:
    hub = secure_hub(opened, keys)
    recon, cliffbot = (robot(opened, hub, keys, name) for name in ROBOTS)
    visitor = robot(opened, hub, keys, "visitor")
    listening_robot, listening_hub = cliffbot.channel("team/**"), hub.channel("**")
    deaf = [visitor.channel("team/**"), cliffbot.channel("world/**"), visitor.channel("**")]
    time.sleep(0.2)  # a subscription takes some milliseconds to be known to the hub

    for key in ("team/cliffbot/0", "team/*/0", "team/**", "team", "world/report/recon"):
        recon.put(key, b"not its own")
    own_words_of_the_visitor = [("team/visitor/0", b"of nobody"), ("team/recon/0", b"of another")]
    for key, words in own_words_of_the_visitor:
        visitor.put(key, words)
    hub.put("world/grant/cliffbot", b"not for the air")
    recon.put("team/recon/0", b"its own")
    assert listening_robot.wait() == ("team/recon/0", b"its own")
    time.sleep(0.2)  # whatever else there was came before, or comes now

    assert heard(listening_robot) == []
    said_at_hub = [("world/grant/cliffbot", b"not for the air"), ("team/recon/0", b"its own")]
    assert heard(listening_hub) == said_at_hub
    # A session always hears itself; of others' words those who may not listen hear nothing.
    assert {message for ear in deaf for message in heard(ear)} <= {*own_words_of_the_visitor}


def test_the_page_shows_the_configuration_that_is_used(tmp_path: Path) -> None:
    folder = Path("/etc/ropeteam")
    shown = json.loads(block("json"))
    for name in ("ca.pem", "hub.pem", "hub.key"):
        (tmp_path / name).touch(mode=0o600)
    config = hub_config(LEASE_MS, "tls/192.168.7.1:7447", Credentials.of(tmp_path, "hub"), ROBOTS)
    used = json.loads(json.dumps(config).replace(str(tmp_path), str(folder)))
    assert shown == used, json.dumps(used, indent=2)


# --- what is refused before anything is opened --------------------------------------------------


@pytest.mark.parametrize(
    ("endpoint", "with_credentials", "says"),
    [
        ("tcp/0.0.0.0:7447", False, "without credentials"),
        ("tcp/[::]:7447", False, "without credentials"),
        ("tcp/192.168.7.1:7447", False, "without credentials"),
        ("tcp/localhost:7447", False, "without credentials"),
        ("tls/127.0.0.1:7447", False, "without credentials"),
        ("tcp/127.0.0.1:7447", True, "has to be tls"),
        ("udp/127.0.0.1:7447", False, "are known"),
        ("tcp/127.0.0.1:7447;tcp/0.0.0.0:7447", False, "without credentials"),
        ("", True, "are known"),
    ],
)
def test_no_frame_goes_to_another_computer_in_the_open(
    endpoint: str, with_credentials: bool, says: str
) -> None:
    with pytest.raises(SecurityError, match=says):
        check_endpoint(endpoint, with_credentials=with_credentials)
    if not with_credentials:
        with pytest.raises(SecurityError):
            open_hub(listen=endpoint)
        with pytest.raises(SecurityError):
            open_client(endpoint)


@pytest.mark.parametrize("endpoint", [LOOPBACK, "tcp/127.8.9.1:1", "tcp/[::1]:7447"])
def test_loopback_needs_no_credentials(endpoint: str) -> None:
    check_endpoint(endpoint, with_credentials=False)


def test_a_private_key_that_others_may_read_is_refused(tmp_path: Path) -> None:
    for name in ("ca.pem", "recon.pem", "recon.key"):
        with pytest.raises(SecurityError, match=f"{name}: cannot be read"):
            Credentials.of(tmp_path, "recon")
        (tmp_path / name).touch(mode=0o600)
    Credentials.of(tmp_path, "recon")
    (tmp_path / "recon.key").chmod(0o640)
    with pytest.raises(SecurityError, match="mode is 640"):
        Credentials.of(tmp_path, "recon")


@pytest.mark.parametrize(
    "robots", [(), ("recon", "recon"), ("*",), ("a/b",), ("**",), ("$x",), ("",)]
)
def test_names_that_would_open_more_than_ones_own_keys_are_refused(robots: tuple[str, ...]) -> None:
    with pytest.raises(SecurityError, match="robots are"):
        access_control(robots)


# --- on one computer ----------------------------------------------------------------------------


def listening() -> set[str]:
    """Return the addresses (hexadecimal, as the kernel writes them) where this process listens."""
    if not Path("/proc/net/tcp").exists():
        pytest.skip("the kernel does not tell who listens where (no /proc/net)")
    links = [os.readlink(path) for path in Path("/proc/self/fd").iterdir() if path.is_symlink()]
    mine = {link[8:-1] for link in links if link.startswith("socket:[")}
    addresses: set[str] = set()
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in (Path("/proc/net") / table).read_text().splitlines()[1:]:
            fields = line.split()
            waits = fields[3] == "0A" or table.startswith("udp")
            if waits and fields[9] in mine:
                addresses.add(fields[1].split(":")[0])
    return addresses


def test_nothing_listens_but_on_loopback(opened: ExitStack) -> None:
    before = listening()
    hub = closed_later(opened, open_hub())
    closed_later(opened, open_client(hub.endpoint))
    assert hub.endpoint.startswith("tcp/127.0.0.1:")
    assert listening() - before == {"0100007F"}

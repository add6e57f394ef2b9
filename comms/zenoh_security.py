"""Who may connect to a hub, and who may say what there: mutual TLS and access control.

On one computer nothing is needed: a hub listens on the loopback interface only. Between computers
both sides prove by certificates of one authority who they are, and the hub lets a robot put on the
keys of its own name and hear those of its team; all else is refused. Here are the settings that say
so, as Zenoh's configuration spells them; `comms.zenoh_air` opens sessions with them.
"""

import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comms.errors import CommsError

LOOPBACK = "tcp/127.0.0.1:0"
"""A free port that no other computer can reach."""
TEAM_KEYS = "team/**"
WORLD_KEYS = "world/**"
_ROBOT = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}")
_ENDPOINT = re.compile(r"(tcp|tls)/(.+):(\d+)")

Tree = dict[str, Any]


class SecurityError(CommsError):
    """Credentials that can't be used, or an endpoint that may not be used without them."""


@dataclass(frozen=True)
class Credentials:
    """Three PEM files: the authority's certificate, one's own, and the private key to that."""

    authority: Path
    certificate: Path
    private_key: Path

    @staticmethod
    def of(folder: Path, name: str) -> "Credentials":
        """Return the credentials of `name` in a folder: ca.pem, NAME.pem and NAME.key.

        Raises:
            SecurityError: one of them can't be read, or others may read the private key.

        """
        credentials = Credentials(folder / "ca.pem", folder / f"{name}.pem", folder / f"{name}.key")
        credentials.check()
        return credentials

    def check(self) -> None:
        """Raise SecurityError where a file can't be read, or others may read the private key."""
        for path in (self.authority, self.certificate, self.private_key):
            try:
                with path.open("rb"):
                    pass
            except OSError as error:
                raise SecurityError(f"{path}: cannot be read: {error.strerror}") from error
        mode = self.private_key.stat().st_mode & 0o777
        if mode & 0o077:
            raise SecurityError(
                f"{self.private_key}: its mode is {mode:o}; only its owner may read a private key"
            )


def hub_settings(
    listen: str,
    credentials: Credentials | None,
    robots: Sequence[str],
    machines: Sequence[str] = (),
) -> Tree:
    """Return what a hub's configuration says of transport and access, beyond what any says.

    Args:
        listen: the endpoint, as tcp/HOST:PORT on loopback or tls/HOST:PORT.
        credentials: the hub's; None: without, which only loopback may be.
        robots: the common names of the robots' certificates, which are their names in the team.
        machines: those of computers that simulate robots.

    Raises:
        SecurityError: the endpoint may not be used so, a file can't, or a name is none.

    """
    check_endpoint(listen, with_credentials=credentials is not None)
    if credentials is None:
        return {}
    tls = _tls(credentials)
    tls["listen_certificate"] = str(credentials.certificate)
    tls["listen_private_key"] = str(credentials.private_key)
    return {"transport": _only_tls(tls), "access_control": access_control(robots, machines)}


def client_settings(endpoint: str, credentials: Credentials | None) -> Tree:
    """Return what a robot's configuration says of transport, beyond what any says.

    Raises:
        SecurityError: the endpoint may not be used so, or a file can't.

    """
    check_endpoint(endpoint, with_credentials=credentials is not None)
    if credentials is None:
        return {}
    tls = _tls(credentials)
    tls["connect_certificate"] = str(credentials.certificate)
    tls["connect_private_key"] = str(credentials.private_key)
    return {"transport": _only_tls(tls)}


def access_control(robots: Sequence[str], machines: Sequence[str] = ()) -> Tree:
    """Return the hub's rules: a robot puts on its own keys and hears the team's; no more.

    A robot is known by the common name of its certificate. Whoever has a certificate of the same
    authority and another name gets in, and can neither speak nor hear. A machine (the runner's
    computer, or one that is offered to it) simulates whole robots: it may say and hear all.

    Raises:
        SecurityError: a name is none, there twice, or there is nobody.

    """
    names = [*robots, *machines]
    wrong = [name for name in names if not _ROBOT.fullmatch(name)]
    if wrong or not names or len(set(names)) < len(names):
        raise SecurityError(
            f"robots are {', '.join(map(repr, names)) or 'none'}; at least one is needed, each "
            f"once, by a name of letters, digits, - and _"
        )
    hear = [
        _rule("subscribe", ["declare_subscriber"], "ingress", TEAM_KEYS),
        _rule("hear", ["put"], "egress", TEAM_KEYS),
    ]
    speak = [_rule(f"speak-{name}", ["put"], "ingress", f"team/{name}/**") for name in robots]
    policies = [
        {"subjects": [name], "rules": ["subscribe", "hear", f"speak-{name}"]} for name in robots
    ]
    if machines:
        words = ["put", "declare_subscriber"]
        simulate = [
            _rule(f"simulate-{flow}", words, flow, TEAM_KEYS, WORLD_KEYS)
            for flow in ("ingress", "egress")
        ]
        speak += simulate
        policies.append({"subjects": list(machines), "rules": [rule["id"] for rule in simulate]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [*hear, *speak] if robots else speak,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in names],
        "policies": policies,
    }


def check_endpoint(endpoint: str, *, with_credentials: bool) -> None:
    """Refuse what would carry frames in the open from one computer to another.

    Raises:
        SecurityError: the endpoint is none, or not tls/ with credentials, or not loopback without.

    """
    parts = _ENDPOINT.fullmatch(endpoint)
    if parts is None:
        raise SecurityError(f"endpoint is {endpoint!r}; tcp/HOST:PORT and tls/HOST:PORT are known")
    protocol, host = parts[1], parts[2]
    if with_credentials and protocol != "tls":
        raise SecurityError(f"endpoint is {endpoint!r}; with credentials it has to be tls/...")
    if not with_credentials and (protocol != "tcp" or not _is_loopback(host)):
        raise SecurityError(
            f"endpoint is {endpoint!r}; without credentials only tcp/127.0.0.1:PORT is allowed"
        )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False  # a name may lead anywhere, even "localhost"


def _tls(credentials: Credentials) -> Tree:
    credentials.check()
    return {
        "root_ca_certificate": str(credentials.authority),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }


def _only_tls(tls: Tree) -> Tree:
    return {"link": {"protocols": ["tls"], "tls": tls}}


def _rule(name: str, messages: list[str], flow: str, *keys: str) -> Tree:
    return {
        "id": name,
        "messages": messages,
        "flows": [flow],
        "permission": "allow",
        "key_exprs": list(keys),
    }

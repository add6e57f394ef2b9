"""Where a router is, and with which certificate one comes to it, as the command line says it."""

from dataclasses import dataclass
from pathlib import Path

from comms.errors import CommsError
from comms.zenoh_air import Wire, open_client, open_hub
from comms.zenoh_security import Credentials
from scenarios.errors import UsageError

LEASE_MS = 600_000
"""A computer that was cut off for less comes back to its session, and nothing that was on its way
is lost: on the virtual clock everybody waits for it."""

FIRST_TRY_S = 60.0
"""So long (wall) an offered computer looks for its router when it starts."""


@dataclass(frozen=True)
class Badge:
    """Who somebody is at a router: the folder of certificates, and the name in it."""

    keys: Path | None
    name: str

    @property
    def credentials(self) -> Credentials | None:
        """The certificates; None: none are used, which only loopback may be.

        Raises:
            UsageError: they can't be used.

        """
        if self.keys is None:
            return None
        try:
            return Credentials.of(self.keys, self.name)
        except CommsError as error:
            raise UsageError(f"--keys {self.keys}: {error}") from error


def connected(endpoint: str, badge: Badge, lease_ms: int = LEASE_MS) -> Wire:
    """Return a wire to a router.

    Raises:
        UsageError: it can't be used so, or nobody answers there.

    """
    try:
        return open_client(endpoint, lease_ms, credentials=badge.credentials)
    except CommsError as error:
        raise UsageError(f"--connect {endpoint}: {error}") from error


def listening(
    endpoint: str,
    badge: Badge,
    *,
    robots: tuple[str, ...] = (),
    machines: tuple[str, ...] = (),
    lease_ms: int = LEASE_MS,
) -> Wire:
    """Return the wire of a router that was opened here.

    Raises:
        UsageError: it can't be opened so.

    """
    try:
        return open_hub(
            lease_ms,
            listen=endpoint,
            credentials=badge.credentials,
            robots=robots,
            machines=machines,
        )
    except CommsError as error:
        raise UsageError(f"--listen {endpoint}: {error}") from error

"""What must be on disk before it may be said, and what is said of a disk that refuses."""

import asyncio
from collections.abc import Callable

from agents.briefing import RobotLog
from agents.disk import Disk, DiskError
from agents.store import Chunk


class Durable:
    """A robot's own layer on its disk, and the journal of what it publishes."""

    def __init__(
        self, disk: Disk, log: RobotLog, content: Callable[[], tuple[object, ...]]
    ) -> None:
        """Write to a disk; `content` returns the own layer as it is now, in the disk's form."""
        self._disk, self._log, self._content = disk, log, content
        self._owes_layer = False
        """Cells of a former life are in the own layer, and not yet on disk under this one."""
        self._told = ""
        """What was said last of a disk that refuses."""

    def owe_layer(self) -> None:
        """Write the own layer now, or before anything is published, if the disk refuses now."""
        self._owes_layer = True
        try:
            self._save(self._content())
        except DiskError as error:
            self.tell(error)

    async def save(self) -> None:
        """Write the own layer; a disk that fails is told, and the robot goes on."""
        content = self._content()
        try:
            await asyncio.to_thread(self._save, content)
        except DiskError as error:
            self.tell(error)

    def _save(self, content: tuple[object, ...]) -> None:
        self._disk.save_layer(content)
        self._owes_layer = False
        self._told = ""

    def journal(self, chunk: Chunk) -> None:
        """Make a version durable that is about to be published.

        Raises:
            DiskError: it is not, and must not be sent.

        """
        if self._owes_layer:
            self._save(self._content())
        self._disk.journal(chunk)

    def confirmed(self) -> bool:
        """Say whether this incarnation is on disk: nothing may be said under it before."""
        try:
            self._disk.confirm()
        except DiskError as error:
            self.tell(error)
            return False
        return True

    def tell(self, error: DiskError) -> None:
        """Say that the disk refuses; once, for as long as it does."""
        if str(error) != self._told:
            self._told = str(error)
            self._log.event("disk", str(error))

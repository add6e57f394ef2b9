"""The page of a run that goes on: opens it, feeds it, and lets it have the last word."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from scenarios.view.desk import Desk, Watched
from scenarios.view.server import Server
from scenarios.view.window import open_page

OPEN_S = 15.0
"""Wall seconds that a browser may take to show the page; then the run begins without it."""


@dataclass
class LivePage:
    """How a run is to be watched, and the watching itself."""

    port: int = 0
    """Where it is served; 0: any free port."""
    opens: bool = True
    """Whether it opens a browser, or only says where the page is."""
    paused: bool = False
    """Whether the run waits for somebody to let it go on."""
    say: Callable[[str], None] = print
    server: Server | None = None
    desk: Desk | None = None

    def begin(self, play: Watched, title: str) -> None:
        """Serve a run that has not begun.

        Raises:
            UsageError: the port is taken.

        """
        assert play.reel is not None
        self.server = Server(title, play.reel.head, self._ask)
        self.server.start(self.port)
        self.desk = play.desk = Desk(self.server.tell, paused=self.paused)
        self.server.tell(self.desk.state())
        self.say(f"Live view: {self.server.address}")
        if not self.opens:
            return
        if open_page(self.server.address):
            self.server.watched.wait(OPEN_S)
        else:
            self.say("No browser can be opened here: open the address yourself.")

    def end(self, play: Watched, told: dict[str, Any]) -> None:
        """Show how the run has ended; the page keeps all that it was shown."""
        assert self.server is not None
        assert self.desk is not None
        self.desk.show(play, now=True)
        self.server.tell({"type": "end", "end": told})

    def close(self) -> None:
        """Serve no more."""
        if self.server is not None:
            self.server.stop()

    def _ask(self, wish: dict[str, Any]) -> None:
        if self.desk is not None:
            self.desk.ask(wish)

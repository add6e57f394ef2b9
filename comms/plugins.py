"""Parts by name: the house's own, and those that installed packages bring as entry points."""

from collections.abc import Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Generic, TypeVar

from comms.errors import CommsError

T = TypeVar("T")


class PluginError(CommsError):
    """A part that does not exist, or whose package can't be loaded."""


class Plugins(Generic[T]):
    """All parts of one kind. Nobody's package is loaded before its part is asked for by name."""

    def __init__(self, group: str, own: Mapping[str, T]) -> None:
        """Take the house's own parts, and the group of entry points in which others are named."""
        self.group = group
        self.own = dict(own)

    def __contains__(self, name: str) -> bool:
        """Say whether there is a part of that name; own ones are found without a search."""
        return name in self.own or name in self._foreign

    def names(self) -> tuple[str, ...]:
        """Return all names: the house's own in their order, then the others by alphabet."""
        return (*self.own, *sorted(self._foreign))

    def find(self, name: str) -> T:
        """Return the part of a name.

        Raises:
            PluginError: there is none, or its package does not load.

        """
        if name in self.own:
            return self.own[name]
        if name not in self._foreign:
            known = ", ".join(self.names())
            raise PluginError(f'{self.group}: none is named "{name}"; there are: {known}')
        point = self._foreign[name]
        try:
            part: T = point.load()
        except Exception as error:  # whatever a stranger's module does when it is imported
            source = f"{point.value} of {point.dist.name}" if point.dist else point.value
            raise PluginError(
                f'{self.group}: "{name}" can\'t be loaded from {source}:'
                f" {type(error).__name__}: {error}"
            ) from error
        return part

    @cached_property
    def _foreign(self) -> dict[str, EntryPoint]:
        """The parts of other packages; the house's own names can't be taken from it."""
        found = sorted(entry_points(group=self.group), key=lambda point: (point.name, point.value))
        return {point.name: point for point in found if point.name not in self.own}

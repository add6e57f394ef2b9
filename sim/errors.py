"""What a user can get wrong about the world."""


class WorldError(Exception):
    """The world can't be made as asked: one sentence with the wrong value and what is allowed."""

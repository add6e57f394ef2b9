"""What can go wrong on the radio side of a robot; every mistake has a class and a sentence."""


class CommsError(Exception):
    """The base of everything that `comms` raises for a caller's or a peer's mistake."""


class CodecError(CommsError):
    """A map that cannot be coded as asked, or bytes that are no coded map."""

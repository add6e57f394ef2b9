"""How payloads are written and read: small whole numbers, poses, variances.

Small whole numbers are varints (seven bits a byte), signed ones zigzag; lengths are millimetres,
yaw tenths of milliradians, variances quarter octaves (`agents.layers`).
"""

from collections.abc import Callable
from typing import TypeVar

from agents.errors import AgentError
from agents.geometry import Pose
from agents.layers import YAW_STEP_RAD, variance_of_step, variance_step

T = TypeVar("T")
Variance = tuple[float, float, float, float]
VARINT_BYTES = 5


class MessageError(AgentError):
    """A payload is no message of its kind."""


class Writer:
    """Builds a payload."""

    def __init__(self) -> None:
        """Start empty."""
        self.data = bytearray()

    def byte(self, value: int) -> None:
        """Add one byte."""
        self.data.append(value)

    def uint(self, value: int) -> None:
        """Add a whole number from 0."""
        while value > 0x7F:
            self.data.append(0x80 | value & 0x7F)
            value >>= 7
        self.data.append(value)

    def sint(self, value: int) -> None:
        """Add a whole number of either sign."""
        self.uint(value * 2 if value >= 0 else -value * 2 - 1)

    def pose(self, pose: Pose) -> None:
        """Add a pose, to the millimetre."""
        for length_m in (pose.x_m, pose.y_m, pose.z_m):
            self.sint(round(length_m * 1000))
        self.sint(round(pose.yaw_rad / YAW_STEP_RAD))

    def variance(self, variance: Variance) -> None:
        """Add four variances, rounded up."""
        self.data.extend(variance_step(v) for v in variance)


class Reader:
    """Takes a payload apart; raises MessageError where it ends too soon."""

    def __init__(self, data: bytes) -> None:
        """Start at the first byte."""
        self._data = data
        self._at = 0

    @property
    def at_end(self) -> bool:
        """Whether everything was read."""
        return self._at >= len(self._data)

    def bytes(self, count: int) -> bytes:
        """Take so many bytes."""
        if count > len(self._data) - self._at:
            raise MessageError(
                f"payload of {len(self._data)} bytes ends inside a field of {count} bytes"
            )
        self._at += count
        return self._data[self._at - count : self._at]

    def byte(self) -> int:
        """Take one byte."""
        return self.bytes(1)[0]

    def uint(self) -> int:
        """Take a whole number from 0, below 2^35."""
        value = 0
        for place in range(VARINT_BYTES):
            if self._at >= len(self._data):
                self.byte()  # which raises
            byte = self._data[self._at]
            self._at += 1
            value |= (byte & 0x7F) << (7 * place)
            if byte < 0x80:
                return value
        raise MessageError(f"a number does not end within {VARINT_BYTES} bytes")

    def sint(self) -> int:
        """Take a whole number of either sign."""
        value = self.uint()
        return value >> 1 if value % 2 == 0 else -(value + 1 >> 1)

    def pose(self) -> Pose:
        """Take a pose."""
        x_mm, y_mm, z_mm, yaw = self.sint(), self.sint(), self.sint(), self.sint()
        return Pose(x_mm / 1000, y_mm / 1000, z_mm / 1000, yaw * YAW_STEP_RAD)

    def variance(self) -> Variance:
        """Take four variances."""
        x, y, z, yaw = (variance_of_step(step) for step in self.bytes(4))
        return (x, y, z, yaw)


def whole(data: bytes, read: Callable[[Reader], T]) -> T:
    """Read one message that fills its payload."""
    reader = Reader(data)
    message = read(reader)
    if not reader.at_end:
        raise MessageError("payload goes on after its message")
    return message

"""Recordings of real robots, or of runs, that stand in for a robot's body and sensor."""

from scenarios.recordings.reading import drive_of, read, recorded

__all__ = ["drive_of", "read", "recorded"]

"""What a robot writes down of its own life, in its MCAP log."""

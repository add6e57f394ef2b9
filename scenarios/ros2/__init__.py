"""Runs as ROS 2 sees them: message types, CDR, `run.mcap`, and messages sent live."""

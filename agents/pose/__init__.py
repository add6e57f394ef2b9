"""Where a robot is: what it measures of its way, what it believes, and what hangs on that."""

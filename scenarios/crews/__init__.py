"""The robots of a run as the runner holds them: all in this process, or each in its own."""

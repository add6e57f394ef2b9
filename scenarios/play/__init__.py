"""A run as the runner sees it while it goes on, on either clock."""

"""A payload sent over the emulated link: on the virtual clock, or between two processes."""

"""Which cells an eye is likely to see from where, over a map that may be wrong."""

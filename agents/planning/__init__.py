"""Where to look next: the paper's measure of information, its rating, and strategies by name."""

"""Trials by chaos: faults drawn from a seed, runs under them, and what must hold all the same."""

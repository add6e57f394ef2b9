"""Pixels to points: what a robot makes of a pair of images."""

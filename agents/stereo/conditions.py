"""What is ill about a look, told in words: nothing is hidden behind an empty cloud."""

from agents.stereo.matching import Grey, Matched

DARK_DN, BRIGHT_DN = 12.0, 250
"""Mean grey level below which an image is too dark, and level from which a pixel is white."""
WHITE, POOR, MATCHED = 0.3, 0.5, 0.4
"""Shares of the image: from which white and poor ground are told of, below which matches are."""


def ill_conditions(left: Grey, right: Grey, matched: Matched) -> tuple[str, ...]:
    """Return the reasons why a look gave less than it should, each a short sentence; often none."""
    told: list[str] = []
    mean = float(min(left.mean(), right.mean()))
    if mean < DARK_DN:
        told.append(f"too dark: mean grey level {mean:.0f} of 255")
    white = float(max((left >= BRIGHT_DN).mean(), (right >= BRIGHT_DN).mean()))
    if white > WHITE:
        told.append(f"too bright: {white:.0%} of the image is white")
    poor = matched.lost.get("little texture", 0.0)
    if poor > POOR:
        told.append(f"little texture: {poor:.0%} of the image can't be matched")
    if matched.density < MATCHED:
        told.append(f"few matches: {matched.density:.0%} of the image has a depth")
    return tuple(told)

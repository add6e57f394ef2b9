"""A robot that does not know where it is finds its own map on the team's.

`searching` tries every turn and shift, `fitting` refines the best to a part of a cell, `ground`
and `floors` say what two maps of a kind tell together, `verdict` whether that is sure, and `joiner`
when a robot tries it.
"""

from agents.joining.joiner import Joiner, own_estimate, placed
from agents.joining.verdict import Joined, NotFound

__all__ = ["Joined", "Joiner", "NotFound", "own_estimate", "placed"]

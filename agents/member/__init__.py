"""What makes a robot a member of its team: what it keeps, tells and hears.

Nothing here moves or looks. A member on a lander, without wheels, would be this and no more.
`Keeper` has the maps, the pose and the disk; `Teller` adds what is said, `Member` what is heard.
"""

from agents.member.keeper import LEG_M, Keeper
from agents.member.member import Member
from agents.member.teller import KEEP_ALIVE_S, SILENT_S, Teller

__all__ = ["KEEP_ALIVE_S", "LEG_M", "SILENT_S", "Keeper", "Member", "Teller"]

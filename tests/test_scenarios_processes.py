"""What a robot's process takes off the air: packets of whoever put them there, and no others."""

from comms.air import Packet
from scenarios.crews.robotprocess import carried


def packet(sender: str) -> Packet:
    return Packet(sender, 3, 0, 10, (("recon", 20),), False, b"sealed")


def test_a_packet_is_taken_from_the_robot_that_put_it_on_the_air() -> None:
    assert carried("team/scout/2", packet("scout").to_wire()) == ("scout#2", packet("scout"))


def test_a_packet_that_names_another_robot_than_its_key_is_not_believed() -> None:
    assert carried("team/scout/0", packet("recon").to_wire()) == ("scout#0", None)


def test_what_is_no_packet_is_dropped() -> None:
    assert carried("team/scout/0", b"\xff garbage") == ("scout#0", None)

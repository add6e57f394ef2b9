"""One robot by itself, on the real clock (`ropeteam agent`): what runs on a robot's own computer.

`settings` is its file, `hardware` finds the driver of its body, `air` is its end of the team's
radio network, `life` ties them together; `simulated` is a driver for trying it without a robot.
"""

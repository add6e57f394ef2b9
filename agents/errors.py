"""What a caller or a peer can do wrong in the robot's room."""


class AgentError(Exception):
    """Base of every error that bad input, not a bug of ours, causes in `agents`."""

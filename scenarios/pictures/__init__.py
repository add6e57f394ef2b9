"""Pictures of a run that a person can read: the truth, each robot's map, and what it cost."""

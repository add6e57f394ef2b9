"""What robots believe held against the truth, which only the study knows."""

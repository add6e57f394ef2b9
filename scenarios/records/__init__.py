"""What is kept of a run: tables, figures, and how they are read back."""

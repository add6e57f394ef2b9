"""The face of a run: a page that shows it, live or afterwards (see docs/view.md)."""

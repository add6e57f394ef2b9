"""The study: scenario files, the runner, the command line, records and reports."""

"""What a user of the studies can do wrong: each an exception of one clear sentence per problem."""

from collections.abc import Sequence


class StudyError(Exception):
    """Bad input to a study; nothing was started and nothing was written."""


class ScenarioError(StudyError):
    """A scenario that can't be run: one sentence per problem, in `problems`.

    Each sentence names the file (or the option of the command line), the key, the value that was
    found and what is allowed there.
    """

    def __init__(self, problems: Sequence[str]) -> None:
        """Keep the sentences; at least one is needed."""
        assert problems, "a ScenarioError without a problem"
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)

    def __reduce__(self) -> tuple[type["ScenarioError"], tuple[tuple[str, ...]]]:
        """Travel between processes whole."""
        return ScenarioError, (self.problems,)


class FolderError(StudyError):
    """A folder that a run may not be written to."""


class UsageError(StudyError):
    """Options of the command line that don't go together."""

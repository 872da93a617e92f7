"""The errors that end a command in one sentence.

INPUTS: the file (or the name of what is only in memory) and what is wrong with it.
OUTPUTS: an exception whose text is one sentence that starts with the file.
"""

from pathlib import Path


class FileError(ValueError):
    """A file cannot be used.

    Attributes:
        path: the file, or a name where there is no file.
        problem: line or field, what was found there, and what was expected.
    """

    def __init__(self, path: str | Path, problem: str):
        # Both go to the base, so that the error survives pickling between processes.
        super().__init__(path, problem)
        self.path = path
        self.problem = problem

    def __str__(self) -> str:
        return f"{self.path}: {self.problem}"


class InputError(FileError):
    """What a user passed cannot be used: a command ends with exit code 2."""


class OutputError(FileError):
    """What was to be written cannot be: a command ends with exit code 1.

    Whatever was there before is as it was.
    """

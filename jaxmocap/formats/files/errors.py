"""The errors that end a command in one sentence.

INPUTS: the file (or the name of what is only in memory) and what is wrong with it.
OUTPUTS: an exception whose text is one sentence that starts with the file, and that any terminal
can show.
"""

from pathlib import Path

# A sentence longer than this is cut, characters.
MAX_SENTENCE_CHARACTERS = 500


def printable(text: str) -> str:
    """Text for a terminal: escapes, line ends and what else does not print stand as Python has it.

    It may hold what a file or a stranger on the network calls things.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shortened(text: str, max_characters: int = MAX_SENTENCE_CHARACTERS) -> str:
    """Text of so many characters at most; what is left out in the middle shows as dots."""
    if len(text) <= max_characters:
        return text
    end = max_characters // 4
    return f"{text[: max_characters - end - 3]}...{text[-end:]}"


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
        return shortened(printable(f"{self.path}: {self.problem}"))


class InputError(FileError):
    """What a user passed cannot be used: a command ends with exit code 2."""


class OutputError(FileError):
    """What was to be written cannot be: a command ends with exit code 1.

    Whatever was there before is as it was.
    """

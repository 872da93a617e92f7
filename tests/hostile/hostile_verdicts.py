"""What the program promises of any input, held against what came of one.

INPUTS: an Answer, the case's folder before and after. OUTPUTS: sentences about what was broken.
"""

import hashlib
import os
import re
import stat
import unicodedata
from collections.abc import Collection
from pathlib import Path

from hostile_pool import LIMIT_S, MOST_BYTES, Answer

CODES = (0, 1, 2)
LONGEST_SENTENCE = 600
# What a user is not to read: names of ours, and what only Python's own texts hold.
INTERNAL = re.compile(
    r"Traceback|None:|\.jaxmocap-|object at 0x|\b[A-Z]\w+(Error|Exception|Warning)\b|\[Errno|"
    r"\barray\(|dtype\(|<class "
)
# Of a live run: its log, and its line of figures.
LIVE = r"^ +\d+\.\d\d s  |\d /s \| "
PROGRESS = re.compile(rf"\d+it \[|\d+%\||it/s|s/it|{LIVE}")
# Characters that steer a terminal, or are invisible: controls, directions, half pairs.
UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")


class Snapshot(dict):
    """Path within a folder -> what is there: a file's hash, a link's target, or its kind."""

    @classmethod
    def of(cls, folder: Path) -> "Snapshot":
        """What a folder and those below it hold."""
        actual = cls()
        for above, folders, files in os.walk(folder):
            for name in (*folders, *files):
                path = Path(above, name)
                actual[path.relative_to(folder).as_posix()] = _what(path)
        return actual


def _what(path: Path) -> str:
    mode = path.lstat().st_mode
    if stat.S_ISLNK(mode):
        return f"link to {os.readlink(path)}"
    if not stat.S_ISREG(mode):
        return f"kind {stat.S_IFMT(mode)}"
    if not os.access(path, os.R_OK):
        return "locked"
    return hashlib.sha256(path.read_bytes()).hexdigest()


def faults(
    answer: Answer, before: Snapshot, after: Snapshot, deep: Path, named: Collection[str] = ()
) -> list[str]:
    """What was broken of the promise by a command that ran ``deep`` in a case's folder.

    What the command line names is its outputs too: these files, and new ones in these folders.
    """
    files = [] if before == after else _of_files(before, after, deep, answer, named)
    if answer.ended:
        return [answer.ended, *files]
    actual = []
    if answer.seconds > LIMIT_S:
        actual.append(f"took {answer.seconds:.0f} s")
    if answer.memory and answer.memory > MOST_BYTES:
        actual.append(f"took {answer.memory / 2**30:.1f} GB")
    if answer.left:
        actual.append(f"threads that do not end: {', '.join(answer.left)}")
    return actual + _of_texts(answer) + files


def _of_texts(answer: Answer) -> list[str]:
    """Of the exit code and what was printed."""
    lines = printed(answer.err)
    if any("Traceback (most recent" in line for line in lines):
        return [f"traceback: {lines[-1][:200]!a}"]
    actual = []
    if answer.code not in CODES:
        actual.append(f"exit code {answer.code}")
    if unseen := sorted({c for c in answer.out if _unseen(c) and c not in "\n\t\r"}):
        actual.append(f"printed {''.join(unseen)!a} to stdout")
    if answer.code == 0:
        # Figures may go to standard output, and the text about them to the other.
        return actual + [f"on stderr: {line[:300]!a}" for line in lines if _is_unclean(line)][:2]
    if len(lines) != 1:
        return [*actual, f"{len(lines)} lines on stderr: {[line[:200] for line in lines[:3]]!a}"]
    return actual + [f"{problem}: {lines[0][:400]!a}" for problem in of_sentence(lines[0])]


def of_sentence(sentence: str) -> list[str]:
    """What is not clean about a sentence."""
    problems = {
        "does not begin with jaxmocap": re.match("jaxmocap[ :]", sentence) is None,
        f"{len(sentence)} characters": len(sentence) > LONGEST_SENTENCE,
        "holds characters that steer": any(map(_unseen, sentence)),
        "is about the program's inside": INTERNAL.search(sentence) is not None,
        "says nothing": len(sentence.split()) < 3,
    }
    return [problem for problem, actual in problems.items() if actual]


def _is_unclean(line: str) -> bool:
    return INTERNAL.search(line) is not None or any(_unseen(c) for c in line if c != "\t")


def _unseen(character: str) -> bool:
    return unicodedata.category(character) in UNSEEN


def printed(text: str) -> list[str]:
    """Lines of stderr but for progress."""
    lines = [line.rsplit("\r", 1)[-1].rstrip("\r") for line in text.split("\n")]
    return [line for line in lines if line.strip() and not PROGRESS.search(line)]


def _of_files(
    before: Snapshot, after: Snapshot, deep: Path, answer: Answer, named: Collection[str]
) -> list[str]:
    """Of what became of the files."""
    actual, out = [], f"{deep.as_posix()}/out/"
    for path, was in before.items():
        now = after.get(path)
        if now == was:
            continue
        what = "is gone" if now is None else "was changed"
        if not path.startswith(out):
            if path not in named or answer.code == 2:
                actual.append(f"{path} {what}")
        elif answer.code == 2 or path.endswith("notes.txt"):
            actual.append(f"the earlier {path} {what}")
    for path in set(after) - set(before):
        above = {path, *(parent.as_posix() for parent in Path(path).parents)}
        if not path.startswith(out) and not above & set(named):
            actual.append(f"{path!a} was written outside")
        elif Path(path).name.startswith(".") and not answer.ended:
            actual.append(f"hidden {path!a} was left")
    return actual

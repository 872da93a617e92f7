"""The text of a TOML file, looked through once before it is parsed.

INPUTS: the text. OUTPUTS: what would keep a parser busy for ever or break it; where its statements
begin.

Python's parser takes a time that grows with the square of a key's parts (16 kB take seconds), and
calls itself for every level of a value.
"""

import re

from jaxmocap.formats.files.short_repr import short_repr

# Levels of brackets, parts of a dotted key, characters of a number or a bare key.
MAX_LEVELS = 32
MAX_KEY_PARTS = 32
MAX_WORD_CHARACTERS = 200

# Texts, comments, and a text that does not end, where a parser stops.
_QUOTED = re.compile(
    r"""
    "{3}(?:[^"\\]++|\\.|"(?!""))*+"{3,5} | '{3}(?:[^']++|'(?!''))*+'{3,5}
    | "(?:[^"\\\n]++|\\[^\n])*+" | '[^'\n]*+' | \#[^\n]*+ | ["'] .*+
    """,
    re.VERBOSE | re.DOTALL,
)
_WORD = r"[^\s\[\]{},=.]"
# From a word's beginning only.
_LONG_WORD = re.compile(f"(?<!{_WORD}){_WORD}{{{MAX_WORD_CHARACTERS + 1},}}")
_LONG_KEY = re.compile(rf"(?<!{_WORD})(?:{_WORD}++[^\S\n]*+\.[^\S\n]*+){{{MAX_KEY_PARTS}}}{_WORD}")
_BRACKETS = re.compile(r"[\[{\]}\n]")


def _bare(text: str) -> str:
    """A text of the same length with a mark for what stands in quotes, and without comments."""
    return _QUOTED.sub(lambda each: (" " if each[0][0] == "#" else "_").ljust(len(each[0])), text)


def parsing_problem(text: str) -> str | None:
    """What is too deep or too long in a text, with its line; None where it may be parsed."""
    bare, levels = _bare(text), 0
    if match := _LONG_WORD.search(bare):
        expected = f"expected at most {MAX_WORD_CHARACTERS} characters without quotes"
        return f"{_line(text, match)}: found {short_repr(match[0])}, {expected}"
    if match := _LONG_KEY.search(bare):
        expected = f"expected at most {MAX_KEY_PARTS} parts between dots"
        return f"{_line(text, match)}: nested too deeply, {expected}"
    for match in _BRACKETS.finditer(bare):
        levels += (match[0] in "[{") - (match[0] in "]}")
        if levels > MAX_LEVELS:
            expected = f"expected at most {MAX_LEVELS} levels"
            return f"{_line(text, match)}: nested too deeply, {expected}"
    return None


def _line(text: str, match: re.Match) -> str:
    return f"line {text.count(chr(10), 0, match.start()) + 1}"


def statement_starts(text: str) -> list[int]:
    """Where the lines of a valid text begin that are not within a value of several lines."""
    levels, starts = 0, [0]
    for match in _BRACKETS.finditer(_bare(text)):
        levels += (match[0] in "[{") - (match[0] in "]}")
        if match[0] == "\n" and levels == 0:
            starts.append(match.end())
    return starts

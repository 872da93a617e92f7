"""The text of a TOML file, looked through once before it is parsed.

INPUTS: the text. OUTPUTS: what would keep a parser busy for ever or break it; where its statements
begin.

Python's parser takes a time that grows with the square of a key's parts, and calls itself for
every level of a value.
"""

import re
from collections.abc import Iterator

from jaxmocap.formats.files.short_repr import short_repr

# Levels of brackets, parts of a dotted key, characters of a number or a bare key.
MAX_LEVELS = 32
MAX_KEY_PARTS = 32
MAX_WORD_CHARACTERS = 200

_TOKEN = re.compile(
    r"""
    (?P<string> "{3}(?:[^"\\]++|\\.|"(?!""))*+"{3,5} | '{3}(?:[^']++|'(?!''))*+'{3,5}
      | "(?:[^"\\\n]++|\\[^\n])*+" | '[^'\n]*+' )
  | (?P<comment> \#[^\n]*+ )
  | (?P<word> [^\s"'\#\[\]{},=.]++ )
  | (?P<open> [\[{] )
  | (?P<close> [\]}] )
  | (?P<dot> \. )
  | (?P<line> \n )
  | (?P<blank> [^\S\n]++ )
  # A text that does not end: there a parser stops.
  | (?P<rest> ["'] .*+ )
  | (?P<other> . )
    """,
    re.VERBOSE | re.DOTALL,
)


def _tokens(text: str) -> Iterator[tuple[str, str, int]]:
    """Kind, text and place of every token."""
    for match in _TOKEN.finditer(text):
        yield match.lastgroup or "other", match[0], match.start()


def parsing_problem(text: str) -> str | None:
    """What is too deep or too long in a text, with its line; None where it may be parsed."""
    levels, parts, after_dot = 0, 0, False
    for kind, token, place in _tokens(text):
        if kind == "blank":
            continue
        if kind == "word" and len(token) > MAX_WORD_CHARACTERS:
            expected = f"expected at most {MAX_WORD_CHARACTERS} characters without quotes"
            return f"{_line(text, place)}: found {short_repr(token)}, {expected}"
        levels += (kind == "open") - (kind == "close")
        if levels > MAX_LEVELS:
            return f"{_line(text, place)}: nested too deeply, expected at most {MAX_LEVELS} levels"
        if kind in ("word", "string"):
            parts = parts + 1 if after_dot else 1
        after_dot = kind == "dot"
        if parts > MAX_KEY_PARTS:
            expected = f"expected at most {MAX_KEY_PARTS} parts between dots"
            return f"{_line(text, place)}: nested too deeply, {expected}"
    return None


def _line(text: str, place: int) -> str:
    return f"line {text.count(chr(10), 0, place) + 1}"


def statement_starts(text: str) -> list[int]:
    """Where the lines of a valid text begin that are not within a value of several lines."""
    levels, starts = 0, [0]
    for kind, _, place in _tokens(text):
        levels += (kind == "open") - (kind == "close")
        if kind == "line" and levels == 0:
            starts.append(place + 1)
    return starts

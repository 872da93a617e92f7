"""What a check finds. See ``checks``."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a recording.

    Attributes:
        check: which check found it.
        sentence: the field, what was found there, and what to change.
        fatal: whether tracking would be nonsense.
    """

    check: str
    sentence: str
    fatal: bool = False

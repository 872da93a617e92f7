"""Whether a recording is what its file states; checked before anything is tracked.

Begin with ``markers``.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a recording."""

    check: str  # which check found it
    sentence: str  # the field, what was found there, and what to change
    fatal: bool = False  # whether tracking would be nonsense

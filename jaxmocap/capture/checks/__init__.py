"""Whether a recording is what its file states; checked before anything is tracked.

Begin with ``markers``.
"""

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

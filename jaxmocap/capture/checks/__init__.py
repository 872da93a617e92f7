"""Whether a recording is what its file states; checked before anything is tracked.

Begin with ``markers``.
"""

"""Whether a recording is what its file says; looked at before anything is tracked.

Begin with ``markers``.
"""

"""All poses of a recording, or of a window, at once.

Begin with ``linearise``, then ``levenberg_marquardt``.
"""

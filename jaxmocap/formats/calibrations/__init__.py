"""Camera calibrations of other systems: each layout in a file of its own.

Begin with ``registry``.
"""

"""Camera calibrations of other systems: each format in a file of its own.

Begin with ``registry``.
"""

"""Calibration files, and videos as a recording names them.

Begin with ``calibration``.
"""

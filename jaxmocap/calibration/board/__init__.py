"""Calibration boards in pictures: found, drawn, printed.

Begin with ``finding``.
"""

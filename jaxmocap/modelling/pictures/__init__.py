"""Photographs before a plain backdrop: masks, medial axes, corners, drawings.

Begin with ``backdrop``.
"""

"""Pairs of the surface's rim and the contours seen, and the pose that they determine (sections 3.1.4, 3.2).

Begin with ``cycles``: a predicted pose to a fitted one.
"""

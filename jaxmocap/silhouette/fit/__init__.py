"""From a predicted pose to a fitted one: pairs of rim and contour, and the solve (3.1.4, 3.2).

Begin with ``cycles``, which runs the others cycle by cycle.
"""

"""The first paper as printed: its inverse kinematics, its chamfer sum, its order of a frame.

Begin with ``frame``. ``ik`` is algorithm 1 with selectively damped least squares, ``chamfer``
equation (13) over soft rasterised cylinders.
"""

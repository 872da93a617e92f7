"""The first paper's own inverse kinematics: selectively damped least squares.

Begin with ``ik``: ``reach`` is algorithm 1.
"""

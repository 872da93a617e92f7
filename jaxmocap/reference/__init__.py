"""The equations once more, in NumPy and float64: naive, obvious, and what the tests hold JAX to.

Each mirrored module has the names and signatures of its original. Nothing here imports ours:
skeletons, poses and cameras are anything with the same attributes.

Begin with ``kinematics``, then ``hybrid/ik``.
"""

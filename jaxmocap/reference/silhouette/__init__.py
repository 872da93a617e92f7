"""The second paper's equations in NumPy.

Begin with ``pose``.
"""

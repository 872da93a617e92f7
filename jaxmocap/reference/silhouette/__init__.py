"""The second paper's equations in NumPy.

Begin with ``level_set``.
"""

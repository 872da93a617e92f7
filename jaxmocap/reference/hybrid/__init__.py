"""The first paper's equations in NumPy.

Begin with ``pipeline``.
"""

"""The first paper's equations in NumPy.

Begin with ``pipeline``; ``search`` is the default's, which the paper does not have.
"""

"""How far outlines of drawn limbs lie from an image's edges.

Begin with ``traced``; the term that uses it is ``evidence.edges``.
"""

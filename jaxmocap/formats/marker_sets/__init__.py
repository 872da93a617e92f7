"""Common sets of markers, and where each of their markers sits on the body.

Begin with ``sets``.
"""

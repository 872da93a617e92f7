"""OpenSim: the coordinates of a published full-body model.

Begin with ``coordinates``.
"""

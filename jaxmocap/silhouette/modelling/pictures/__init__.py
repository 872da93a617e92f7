"""A photograph's silhouette: the person before a backdrop, medial axes, corners; and drawings.

Begin with ``backdrop.person_mask``.
"""

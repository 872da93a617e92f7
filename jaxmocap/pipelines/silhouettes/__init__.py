"""A recording to a motion by the silhouette tracker; a person from photographs.

Begin with ``track``.
"""

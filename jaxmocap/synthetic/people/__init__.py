"""Synthetic people: bodies that the movements move, and their surfaces.

Begin with ``figure``, from posture to bones; ``clothed_person`` is its surface. ``rigged_mesh`` is
a body from a file, with a ``shoulder_girdle``; ``meshes`` are the surfaces of both.
"""

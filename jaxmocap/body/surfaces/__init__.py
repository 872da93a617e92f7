"""The body's surface: cones on bones, a lofted generic body, meshes.

Begin with ``surface``: patches of nodes that bones carry.
"""

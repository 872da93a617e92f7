"""Synthetic people: bodies of blocks, rigged meshes, clothes.

Begin with ``clothed_person``.
"""

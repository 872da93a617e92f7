"""Skeletal animation: BVH and glTF, read and written.

Begin with ``export``.
"""

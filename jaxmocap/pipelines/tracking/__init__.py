"""A recording to a motion by the hybrid tracker.

Begin with ``track``.
"""

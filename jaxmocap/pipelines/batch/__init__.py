"""Many recordings, side by side.

Begin with ``batch``.
"""

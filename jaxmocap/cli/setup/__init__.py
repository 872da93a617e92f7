"""The commands that prepare a recording: check, sync, scale, offsets.

Begin with ``check``.
"""

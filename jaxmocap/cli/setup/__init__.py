"""The commands that prepare a recording: check, sync, keypoints, scale, offsets.

Begin with ``check``.
"""

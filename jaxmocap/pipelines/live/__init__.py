"""Devices to poses as they come.

Begin with ``session``, then ``loop``.
"""

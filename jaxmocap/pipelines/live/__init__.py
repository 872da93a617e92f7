"""A live run: samples and frames of devices in, poses out, as they come.

Begin with ``session``, then ``loop``.
"""

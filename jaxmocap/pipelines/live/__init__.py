"""A live run: samples and frames of devices in, poses out, as they come.

Begin with ``session``, the command from its file to its end, then ``loop``, which connects devices,
tracker and receivers. ``tracking`` steps the tracker, ``recording`` and ``files`` write to disk,
``status`` reports what happens.
"""

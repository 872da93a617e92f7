"""From files and devices to events: marker samples and video frames, in order of time.

Videos, markers at any time, filters, key points, checks of a recording (``checks``) and live
streams (``streams``). Begin with ``footage`` (the videos of a recording) and ``timeline`` (their
events).
"""

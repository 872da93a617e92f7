"""The commands that make poses of recordings and streams: demo, track, batch, live, warmup.

Begin with ``track``.
"""

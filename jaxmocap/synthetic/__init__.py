"""Synthetic recordings: movements, people and a renderer, with the truth.

Begin with ``recording``, which writes one of table tennis; ``four_cameras`` writes one without
markers. The renderer shares no code with the trackers' images, so that none is tested on its own
raster.
"""

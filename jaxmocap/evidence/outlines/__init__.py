"""How far drawn limbs lie from an image's edges: by their outlines, or by the area they cover.

Begin with ``traced``, the default; ``coverage`` is the first paper's sum over the filled raster.
The term that uses either is ``evidence.edges``.
"""

"""Pixels to fields and back.

Begin with ``regions`` (where in an image a field lies) and ``edges`` (distances to edges). A
learned ``background_model`` and ``colours`` become log-odds of the person in ``foreground``;
``raster`` and ``silhouette_grid`` compare drawn limbs with them, ``sampling`` looks fields up,
``canvases`` are the square windows that the silhouette tracker segments.
"""

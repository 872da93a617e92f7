"""Where the person is in each image (second paper, section 4.1), and the contours there.

Level sets start from the predicted silhouettes (``segment``, ``level_set``, ``densities``), single
pixels decide where exactly they end (``sharpen``), and points are taken from them (``contour``).
Background models are learned on the way. Begin with ``outlines``: images to contours.
"""

"""The surface as the silhouette tracker moves it: its rim in each image, morphing, shape.

Begin with ``rim``.
"""

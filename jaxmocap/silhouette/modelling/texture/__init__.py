"""The colours of a person's surface: photographs fused into one picture.

Begin with ``blend_colours``.
"""

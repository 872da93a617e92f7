"""Where the person is in each image (second paper, section 4.1), and the contours there.

Begin with ``outlines``: what each camera shows, as contours.
"""

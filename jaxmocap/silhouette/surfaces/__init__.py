"""The person's surface as cameras see it: dense, morphed by the joints' angles, its rim.

Begin with ``rim``: a shape and a pose to the nodes on its occluding boundary. ``shape`` estimates
the person's own shape by a whole recording's contours.
"""

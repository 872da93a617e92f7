"""What a person and a room look like to a camera, learned, so that frames become silhouettes.

Begin with ``learned``; ``running`` is the same for a live run.
"""

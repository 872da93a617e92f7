"""Where to put the camera, before anything is filmed.

Begin with ``plan``; ``requirements`` is what it must keep to, ``subject`` who moves, ``results``
what it says, ``floor_plan`` a picture of that.
"""

"""Where to put the camera, before anything is filmed.

Begin with ``plan``; ``wishes`` is what it must keep to, ``subject`` who moves, ``results`` what it
says.
"""

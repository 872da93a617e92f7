"""The first paper's system: markers and one camera.

Begin with ``step``: ``solve`` and ``refine`` are what happens at an event, in named calls.
``tracker`` keeps the state between events; ``settings`` holds every number that may be changed.
"""

"""What follows from a smoothed recording: a person's lengths, places of cameras.

Begin with ``lengths``; ``camera_plan`` is a room of its own.
"""

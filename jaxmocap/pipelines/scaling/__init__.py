"""A person's body from height and mass, a static trial, or a clip of movement.

Begin with ``scale``.
"""

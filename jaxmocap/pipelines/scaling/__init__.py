"""A person's body from height and mass, a static trial, or a recording of movement.

Begin with ``scale``; ``fit_lengths`` is the way by a recording, ``lengths_report`` its results.
"""

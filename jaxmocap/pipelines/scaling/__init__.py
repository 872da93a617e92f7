"""A person's body from a recording of movement.

Begin with ``fit_lengths``; ``lengths_report`` is its results.
"""

"""What follows from a smoothed recording: a person's lengths, and sensitivities.

Begin with ``lengths``.
"""

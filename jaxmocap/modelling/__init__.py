"""A person's own model from four photographs (second paper, section 2).

Begin with ``person``: the story of that section.
"""

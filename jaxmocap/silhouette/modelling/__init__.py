"""A person's own model from four photographs (second paper, section 2)."""

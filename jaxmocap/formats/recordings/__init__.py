"""A recording's TOML file, and what it refers to.

Begin with ``recording``.
"""

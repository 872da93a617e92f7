"""What all formats share: reading of bounded size, atomic writing, errors, TOML, JSON and NPZ.

Begin with ``reading`` and ``writing``.
"""

"""The newest events of a run, solved again and again while older ones are condensed.

Begin with ``advance``, the pure function; ``state`` has what it keeps.
"""

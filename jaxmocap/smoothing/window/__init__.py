"""The newest events of a run, solved again and again while older ones are condensed.

Begin with ``sliding``; ``events`` has what it keeps of each.
"""

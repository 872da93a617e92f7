"""What a command does from end to end.

Begin with ``tracking.track``.
"""

"""The commands for what was tracked: evaluate, view, convert, retarget.

Begin with ``evaluate``.
"""

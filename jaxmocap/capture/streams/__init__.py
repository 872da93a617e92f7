"""Devices and network streams of a live run.

Begin with ``inbox``: what has come in and waits for the tracker.
"""

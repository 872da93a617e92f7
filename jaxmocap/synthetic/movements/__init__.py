"""Movements of synthetic people: strokes, squats, exercises, as functions of time.

Begin with ``motions``.
"""

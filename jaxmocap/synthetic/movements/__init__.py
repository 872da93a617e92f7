"""Movements of synthetic people.

Begin with ``motions``.
"""

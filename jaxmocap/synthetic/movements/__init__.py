"""Movements of synthetic people as functions of time.

Begin with ``motions``: table tennis, squats, reaching, thrusts. ``exercises`` are those of a rigged
mesh, made of ``stances`` by an ``exerciser``; ``splines`` join the keys of both.
"""

"""Errors against a reference, tables and plots of them.

Begin with ``errors``. ``errors.evaluate`` compares a motion in memory,
``errors.evaluate_directory`` what ``track`` wrote; ``series`` pairs samples by time.
"""

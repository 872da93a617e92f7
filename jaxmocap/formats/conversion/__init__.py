"""Samples over time made regular: other rates, and gaps.

Begin with ``resampling``.
"""

"""Benchmarks: ``python -m bench`` for speed, ``python -m bench.accuracy`` for elbow errors."""

"""Streams over time: markers and video."""

"""Pixels to fields and back."""

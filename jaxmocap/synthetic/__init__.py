"""Motions and a renderer that make recordings."""

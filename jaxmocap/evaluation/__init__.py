"""Errors against a reference, and plots."""

"""Errors against a reference, and plots of them."""

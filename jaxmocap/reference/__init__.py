"""The equations again in NumPy: naive and obvious, for tests."""

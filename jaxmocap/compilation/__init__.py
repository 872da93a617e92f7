"""Compiled functions: traced once for this start and for later ones, and batches of one size.

Begin with ``programs``. ``arrays`` go between host and device without compiling anything.
"""

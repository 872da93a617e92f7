"""Files as such: reading of bounded size, writing that is whole or not there, errors.

Begin with ``reading`` and ``writing``.
"""

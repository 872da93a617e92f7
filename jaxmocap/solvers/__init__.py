"""Functions of functions: optimisers without body or image.

Begin with ``sdls``: the step of the first paper's inverse kinematics. ``simplex`` searches without
derivatives, ``least_squares`` with them; ``banded`` and ``arrow`` solve the systems of a smoother.
"""

"""Evidence about a pose: one file a term, with its settings, residual and Jacobian.

Begin with ``residuals``. Solvers and smoothers take a tuple of terms.
"""

"""Evidence about a pose: one file a term, with its settings, residual and Jacobian.

Begin with ``terms``: what a term is, and ``residuals`` of many. Solvers and smoothers take a tuple
of terms.
"""

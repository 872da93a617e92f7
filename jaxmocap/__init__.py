"""Human motion capture from three tracked points and one ordinary camera, in JAX."""

__version__ = "0.1.0"

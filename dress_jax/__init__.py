"""Sewing patterns, a differentiable intersection-free cloth simulator and its renderer, in JAX."""

__version__ = "0.1.0"

"""Differentiable rasterization."""

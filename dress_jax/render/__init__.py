"""Differentiable rasterization: cameras, visibility, silhouettes, images."""

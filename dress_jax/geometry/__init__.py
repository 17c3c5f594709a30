"""Meshes, curves, distances and exact tests, free of cloth and of patterns."""

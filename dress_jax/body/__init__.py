"""Parametric and static bodies."""

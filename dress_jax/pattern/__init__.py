"""Sewing patterns: the file dialects, their parameters and their discretization."""

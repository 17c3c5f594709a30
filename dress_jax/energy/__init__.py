"""Elastic and external energies: one pure stencil function each."""

"""Collision candidates, barrier, friction and the CCD step bound."""

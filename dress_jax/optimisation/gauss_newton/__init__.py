"""Gauss-Newton with damping: outlines of the drape against outlines of the images."""

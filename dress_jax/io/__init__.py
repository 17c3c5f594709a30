"""Files: the only library layer that touches them."""

"""Real patterns recovered from pictures of their own drapes: see `__main__`."""

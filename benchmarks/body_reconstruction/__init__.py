"""Bodies found again in pictures of themselves, half of them hidden."""

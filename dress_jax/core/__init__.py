"""Data carriers, precision, results and shape buckets: what every layer shares."""

"""Pattern optimisation as init and step over an explicit state."""

"""How a person moves: motions as data, made or retargeted, and the bodies of their frames (S15)."""

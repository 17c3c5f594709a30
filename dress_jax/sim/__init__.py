"""The differentiable cloth simulator and how a garment gets onto a body."""

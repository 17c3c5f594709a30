"""The texture of a fitted garment in its pattern's space: from one cut, or from all views (S14)."""

"""cotree."""

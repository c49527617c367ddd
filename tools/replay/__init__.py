"""Look at a logged episode again, decide on it again, try it again."""

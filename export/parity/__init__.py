"""The proof that a bundle equals the model it came from."""

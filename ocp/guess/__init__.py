"""Initial guesses: values, paths to the target, and inverse dynamics."""

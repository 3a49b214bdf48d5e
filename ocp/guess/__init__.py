"""Initial guesses by paths to the goals and inverse dynamics."""

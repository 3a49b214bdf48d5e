"""The search for a plan: what is refused beforehand, what is tried, and in which order."""

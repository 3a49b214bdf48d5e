"""Search for plans: checks, attempts, and their order."""

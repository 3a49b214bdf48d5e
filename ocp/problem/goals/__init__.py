"""States that are wanted at the end, on the way, and from period to period."""

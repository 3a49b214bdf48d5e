"""Final states that meet the goals, and independent goal constraints."""

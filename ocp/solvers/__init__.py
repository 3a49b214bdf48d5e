"""Methods that solve the program, and what they say of its multipliers."""

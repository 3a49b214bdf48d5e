"""What a simulation costs and how wrong it is; natural modes."""

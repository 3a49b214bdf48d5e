"""Target states of goals, and the constraints that impose them."""

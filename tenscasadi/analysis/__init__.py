"""Cost and errors of simulations, the scheme that suits a tolerance, and natural modes."""

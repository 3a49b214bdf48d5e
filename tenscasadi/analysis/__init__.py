"""Accuracy and cost of simulations, and natural modes."""

"""Optimal control problems: goals, bounds, costs and their expressions."""

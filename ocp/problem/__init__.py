"""A plan that is asked for: goals, bounds, costs, and the expressions they become."""

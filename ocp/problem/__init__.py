"""What is asked of a plan: goals, bounds, costs, and the expressions they become."""

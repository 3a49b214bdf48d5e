"""The equations of motion: forces, constraint forces, state space, and the model that holds them."""

"""Interactive simulations in the viewer."""

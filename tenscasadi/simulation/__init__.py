"""From a model and a scheme to a trajectory that carries its own errors."""

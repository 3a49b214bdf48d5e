"""Large plans: a Newton method in the force densities alone, about a motion that is condensed out."""

"""Equilibrium and self-stress of structures."""

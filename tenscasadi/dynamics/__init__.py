"""Equations of motion: forces, constraint forces, state space, model."""

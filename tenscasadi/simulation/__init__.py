"""Simulation of a model to a trajectory with errors."""

"""Simulation of models, with estimates of numerical errors."""

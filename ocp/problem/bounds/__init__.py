"""Bounds on positions, forces and their rates."""

"""Limits of motion, forces and their rates."""

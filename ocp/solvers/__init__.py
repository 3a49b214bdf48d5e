"""Solvers of nonlinear programs, and duals by name."""

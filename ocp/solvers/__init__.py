"""Solvers of the nonlinear programs, and Lagrange multipliers by name."""

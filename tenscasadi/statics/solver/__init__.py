"""Solvers of static equations: Newton's method, trust region, continuation."""

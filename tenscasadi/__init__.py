"""Tensegrity dynamics as CasADi Functions."""

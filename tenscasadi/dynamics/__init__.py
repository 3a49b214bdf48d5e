"""Equations of motion of a scene, and their CasADi Functions."""

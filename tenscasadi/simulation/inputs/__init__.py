"""Inputs of runs: starts, parameters, controls and time steps."""

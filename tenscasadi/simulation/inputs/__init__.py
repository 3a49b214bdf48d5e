"""Inputs of runs: initial states, parameters, controls and time steps."""

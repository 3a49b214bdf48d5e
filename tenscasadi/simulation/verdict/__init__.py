"""Acceptance test of runs."""

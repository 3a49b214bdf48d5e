"""Least mass of members under load cases."""

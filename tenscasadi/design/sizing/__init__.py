"""Sizing: cross-sections of members with the smallest mass."""

"""Motions in a browser: played, compared, saved as pages, and driven while they are computed."""

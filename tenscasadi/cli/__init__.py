"""Command line of tenscasadi."""

from __future__ import annotations

from tenscasadi.cli.main import main

__all__ = ["main"]

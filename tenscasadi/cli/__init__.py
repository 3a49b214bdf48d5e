"""The command line."""

from __future__ import annotations

from tenscasadi.cli.main import main

__all__ = ["main"]

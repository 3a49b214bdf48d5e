"""The browser's fixture, for the test that reads the site."""

from __future__ import annotations

from browser import browser

__all__ = ["browser"]

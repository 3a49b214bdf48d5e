"""Names of earlier versions."""

from __future__ import annotations

from tenscasadi.util.renamed import find_attribute

__getattr__ = find_attribute("tenscasadi.viewer", {}, {"Stepping": "LiveOptions"})

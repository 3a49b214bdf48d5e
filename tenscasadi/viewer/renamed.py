"""Names of earlier versions."""

from __future__ import annotations

from tenscasadi.util.renamed import find_renamed
from tenscasadi.viewer.live_mode.options import LiveOptions

__getattr__ = find_renamed("tenscasadi.viewer", {"Stepping": ("LiveOptions", LiveOptions)})

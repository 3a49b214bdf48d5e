"""Import and export of MuJoCo's XML format, MJCF."""

from tenscasadi.exchange.mjcf.export import export_mjcf
from tenscasadi.exchange.mjcf.importing import import_mjcf

__all__ = ["export_mjcf", "import_mjcf"]

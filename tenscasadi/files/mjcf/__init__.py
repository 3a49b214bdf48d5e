"""MuJoCo's XML format, MJCF: scenes to it, and back from what maps."""

from tenscasadi.files.mjcf.export import export_mjcf
from tenscasadi.files.mjcf.importing import import_mjcf

__all__ = ["export_mjcf", "import_mjcf"]

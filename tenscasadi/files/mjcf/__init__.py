"""MuJoCo's XML format, MJCF: scenes to it, and back from what maps."""

from tenscasadi.files.mjcf.export import export_mjcf

__all__ = ["export_mjcf"]

"""Pages of the viewer: written as files, or served to browsers."""

"""Pages: written as files, or served to the browsers of this machine."""

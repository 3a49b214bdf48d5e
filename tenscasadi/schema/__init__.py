"""Values that define their fields, checks, texts and files."""

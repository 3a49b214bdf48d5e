"""Classes whose fields define their checks, texts and files."""

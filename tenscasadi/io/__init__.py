"""Scene files: parsing, tables, and their JSON Schema."""

"""Scene files: documents, their sections, and their JSON Schema."""

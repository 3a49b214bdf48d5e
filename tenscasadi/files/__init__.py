"""Scene files in TOML, their definitions and their JSON Schema."""

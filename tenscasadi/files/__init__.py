"""Files: scenes in TOML, their definitions and JSON Schema, and the formats of other programs."""

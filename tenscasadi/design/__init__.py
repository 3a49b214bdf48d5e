"""Design of structures: form, prestress and sections of members."""

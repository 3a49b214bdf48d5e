"""Design of structures: their form, their prestress and the sections of their members."""

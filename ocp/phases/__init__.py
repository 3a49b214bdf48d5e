"""Plans in phases: which nodes stand when; nodes land with an impact, and all phases are one program."""

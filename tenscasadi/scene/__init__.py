"""Scenes: a structure, how its strings are driven, its loads and its supports."""

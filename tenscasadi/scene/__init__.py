"""Scenes: structures with control, string laws, loads, grounds and supports."""

"""Sweeps over independent cases on many cores or a cluster."""

"""Many motions at once, and many jobs on many machines."""

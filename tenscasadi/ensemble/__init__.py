"""Many motions of one model at once."""

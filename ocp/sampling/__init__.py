"""Plans and control by sampled motions, without derivatives."""

"""Plans from sampled motions: random force densities, the best kept, and the last misses removed; shared with control by sampling."""

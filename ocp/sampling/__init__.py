"""Planning by random sampling of simulations, without derivatives."""

"""Solution of static equations: Newton systems, trust region, continuation."""

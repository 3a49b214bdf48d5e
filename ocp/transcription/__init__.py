"""From a problem in continuous time to a sparse nonlinear program."""

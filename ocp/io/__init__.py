"""Scene files with optimal control problems, table [plan]."""

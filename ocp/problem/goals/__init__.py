"""Goals: terminal constraints, waypoints and periodicity."""

"""Import from NASA's Tensegrity Robotics Toolkit (NTRT)."""

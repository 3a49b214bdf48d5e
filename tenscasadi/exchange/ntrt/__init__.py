"""Import from NASA's Tensegrity Robotics Toolkit (NTRT), in its YAML format."""

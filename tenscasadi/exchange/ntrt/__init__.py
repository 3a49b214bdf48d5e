"""Files of NASA's Tensegrity Robotics Toolkit (NTRT)."""

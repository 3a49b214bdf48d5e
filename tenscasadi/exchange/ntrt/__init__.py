"""Structures of NASA's Tensegrity Robotics Toolkit (NTRT), in its YAML format."""

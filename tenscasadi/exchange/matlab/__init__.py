"""MATLAB files with the variable names of MOTES and TsgFEM."""

"""MATLAB's .mat files, with the names that MOTES and TsgFEM give to structures and motions."""

"""Import and export for MuJoCo, MATLAB, NTRT and ParaView."""

"""Import and export of files of MuJoCo, MATLAB, NTRT and ParaView."""

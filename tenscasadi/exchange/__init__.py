"""Files of other programs: MuJoCo, MATLAB, NTRT, ParaView."""

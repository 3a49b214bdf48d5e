"""The live mode of the viewer: a simulation that people drive while they watch it."""

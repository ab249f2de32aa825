"""The commands of the program `voxflat`, one a module."""

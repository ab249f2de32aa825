"""The commands of the program `voxflat`, one per module."""

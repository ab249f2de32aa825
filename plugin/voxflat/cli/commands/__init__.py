"""Define the commands of the program `voxflat`, one per module."""

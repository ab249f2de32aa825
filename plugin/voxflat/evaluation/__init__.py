"""Evaluation of flat maps, made by voxflat or any other tool, with the same definitions."""

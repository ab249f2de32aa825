"""Evaluation of flat maps, made by voxflat or any other tool, by the same definitions."""

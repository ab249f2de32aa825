"""Cuts by hand: drawn on the surface in 3D, undone and redone, weighed, saved, and used by *Flatten surface*."""

"""Draw cuts on the surface in 3D, undo and redo changes, and evaluate, save and use the cuts in *Flatten surface*."""

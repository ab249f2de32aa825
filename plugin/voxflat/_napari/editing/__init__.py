"""Drawing cuts on the surface in 3D: undo and redo, evaluating, saving, and using them in *Flatten surface*."""

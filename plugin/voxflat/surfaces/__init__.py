"""Surfaces: what volumes, range images and meshes become, which part of them is flattened, and where it is cut."""

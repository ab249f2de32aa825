"""Create surfaces from volumes, range images and meshes, select the part to flatten, and cut it."""

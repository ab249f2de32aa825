"""One frame for all brains: what is known on fsaverage's sphere, and how a surface gets there."""

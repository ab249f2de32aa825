"""The docks that napari opens."""

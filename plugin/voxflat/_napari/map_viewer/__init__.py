"""The dock that shows flat maps on its own canvas, linked to the volume or surface in the viewer."""

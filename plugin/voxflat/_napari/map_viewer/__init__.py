"""The dock that shows flat maps on its own canvas, linked with the volume or surface in the viewer."""

"""The dock that shows flat maps on a canvas of its own, and links them with the volume or surface they are of."""

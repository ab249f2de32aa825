"""The main pipeline: from any input to a `Surface`, its parts, a `CutSurface`, and a `FlatMap`."""

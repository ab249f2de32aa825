"""The pipeline that users walk: from anything to a `Surface`, its parts, a `CutSurface`, and a `FlatMap`."""

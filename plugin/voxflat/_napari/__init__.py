"""The napari plugin: docks that flatten surfaces and show maps, sample data, and file readers and writers.

`layers` converts napari layers to volumes, meshes and points in mm. `job` describes a flattening, which `worker`
runs in another thread and `scripts` writes as Python. `results` converts maps and atlases to layers and text.
`viewer_state` holds the runs of a viewer, and `gl_context` prevents crashes when layers are removed. `forms` contains
the forms, `widgets` the docks that flatten, `map_viewer` the dock with the map, `editing` the dock for drawing cuts,
and `checking` the docks with tables. `samples` opens sample data; `files` reads and writes files. `layers`, `job`,
`scripts` and most of `results` do not use Qt. `napari.yaml` lists the contributions to napari.
"""

"""The napari plugin: *Layers → Transform → Flatten surface*, the demo cortex, and files that are opened and saved.

`layers` takes napari's layers to volumes, meshes and places in mm; `job` is one flattening, which `worker` runs in
another thread; `scripts` says it in Python; `results` takes maps and atlases to layers and to words; `workbench` keeps
the runs of a viewer, whatever dock is open, and `gl_context` the viewer from crashing as layers go; `map_viewer` is the
dock that shows them, linked with the viewer; `forms` asks what to do; `widgets` are the docks of forms and figures.
`editing` draws cuts, `checking` tells of surfaces and maps in tables. `samples` opens data, and `files` what lies on a
disk, or saves it. `layers`, `job`, `scripts` and most of `results` need no Qt. `napari.yaml` names what napari offers.
"""

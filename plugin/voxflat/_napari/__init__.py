"""The napari plugin: *Layers → Transform → Flatten surface*, the demo cortex, and files that are opened and saved.

`layers` takes napari's layers to volumes, meshes and places in mm; `job` is one flattening, which `worker` runs in
another thread; `scripts` says it in Python; `results` takes maps and atlases to layers and to words, and shows them;
`workbench` keeps the runs of a viewer, whatever dock is open; `forms` asks what to do;
`widgets` are the docks, made of forms and results. `checking` tells of surfaces and maps in tables. `samples` opens
data, and `files` what lies on a disk, or saves it. Only `forms`, `widgets`, `worker`, `checking` and
`results.map_panel` need Qt. `napari.yaml` names what napari offers.
"""

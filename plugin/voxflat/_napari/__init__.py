"""The napari plugin: *Layers → Transform → Flatten surface*, the demo cortex, and a reader of saved flat maps.

`volumes` takes layers to volumes and places to voxels; `job` is one flattening; `results` takes a flat map to layers;
`map_view` shows them. None of these needs Qt, which only the widget (`flatten_surface`) and its parts (`layer_choice`,
`seed_choice`, `worker`) import. `napari.yaml` names what napari offers.
"""

"""The napari plugin: *Layers → Transform → Flatten surface*, the demo cortex, and a reader of saved flat maps.

`world` says where layers lie, `volumes` and `meshes` take them to RAS+ mm, `seed` takes places to voxels and vertices;
`sampled` is what a map shows; `job` is one flattening; `results` takes a flat map to layers, `page_results` an atlas,
`report` both to words; `map_view` shows the layers. None of these needs Qt, which only the widgets (`flatten_surface`
and `flatten_patches`, on `flatten_widget`) and their parts (`layer_form`, `form`, `patches_form`, `layer_choice`,
`label_choice`, `seed_choice`, `map_panel`, `worker`) import. `napari.yaml` names what napari offers.
"""

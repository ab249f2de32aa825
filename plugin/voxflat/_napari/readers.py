"""The reader of flat maps and atlases that were saved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from voxflat._napari.results.flat_layers import LayerData
from voxflat._napari.results.maps import map_layers
from voxflat._napari.results.pages import page_layers
from voxflat.atlases.certified import load_atlas
from voxflat.atlases.saved import saved_kind
from voxflat.maps.flat_map import load


def flat_map_reader(path: str | list[str] | None = None) -> Callable[[str], list[LayerData]] | None:
    """Offer to read a file, if it is a flat map or an atlas of voxflat.

    Parameters
    ----------
    path : str or list of str, optional
        The file, or files to be stacked, which flat maps are not. Without one, as napari's command palette calls it,
        the user is asked for the file, and it is opened.

    Returns
    -------
    callable or None
        Takes the path, and returns layers.
    """
    if path is None:
        _ask()
    if not isinstance(path, str):
        return None
    return {"map": _map, "atlas": _atlas, None: None}[saved_kind(path)]


def _ask() -> None:
    """Ask for a file, and open it in napari's window."""
    from napari import current_viewer
    from qtpy.QtWidgets import QFileDialog

    viewer = current_viewer()
    path, _ = QFileDialog.getOpenFileName(None, "Read a flat map", "", "Flat maps and atlases (*.voxflat *.npz)")
    if viewer is not None and path:
        viewer.open(path, plugin="voxflat")


def _map(path: str) -> list[LayerData]:
    """Read a flat map that was saved."""
    return map_layers(load(path), Path(path).stem).layers


def _atlas(path: str) -> list[LayerData]:
    """Read an atlas that was saved.

    Parameters
    ----------
    path : str
        An .npz or .voxflat file.

    Returns
    -------
    list of LayerData
        The page's images, and the surface, which is hidden.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    atlas = load_atlas(path)
    atlas.metadata["napari"] = {"layer": Path(path).stem, "world_axes": "RAS", "unit": "millimeter"}
    drawn = page_layers(atlas)
    for _, keywords, _ in drawn.in_space:
        keywords["visible"] = False  # it would lie across the page
    return [*drawn.in_space, *drawn.layers]

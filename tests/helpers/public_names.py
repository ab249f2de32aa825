"""All public classes, functions and methods."""

import importlib
import inspect

import voxflat

NAMES = {
    "voxflat": voxflat.__all__,
    **{f"voxflat.{name}": getattr(voxflat, name).__all__ for name in ("methods", "figures", "io", "samples", "vtk")},
    # classes whose objects users receive but never make
    "voxflat._pyvista.accessor": ["VoxflatAccessor"],
    "voxflat._pyvista.blocks": ["BlocksAccessor"],
    "voxflat._pyvista.morphs": ["Morph"],
    "voxflat.atlases.certified": ["Certificate", "FlatPatch", "Plane"],
    "voxflat.atlases.glued": ["GluedPiece", "Seams"],
    "voxflat.atlases.page": ["FlatPage"],
    "voxflat.distortion.figures": ["Figures", "StandardErrors", "TriangleFigures"],
    "voxflat.io.origin": ["Origin"],
    "voxflat.evaluation.measure": ["MeasuredMap"],
    "voxflat.lab.map_page": ["MapPage"],
    "voxflat.maps.plane": ["FlatTriangles"],
    "voxflat.maps.textures.textured": ["TexturedSurface"],
    "voxflat.maps.worst_places": ["RelievingCut", "WorstPlace"],
}


def public():
    """Return all public classes, functions and methods by the names of their definitions."""
    found = {}
    for module, names in NAMES.items():
        for name in names:
            thing = getattr(importlib.import_module(module), name)
            bases = getattr(thing, "__mro__", ())
            members = (one for base in bases for one in vars(base).items())
            methods = [getattr(value, "__func__", value) for key, value in members if not key.startswith("_")]
            for one in (thing, *(one for one in methods if inspect.isfunction(one))):
                is_ours = getattr(one, "__module__", "").startswith("voxflat") and hasattr(one, "__qualname__")
                if is_ours and not one.__name__.startswith("Request"):  # called by VTK
                    found[f"{one.__module__}.{one.__qualname__}"] = one
    return found

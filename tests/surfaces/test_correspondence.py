"""Files of another surface with the same number of vertices: both sides of fsaverage5 have 10,242."""

import logging

import nibabel as nib
import numpy as np
import pytest
from mesh_files import fsaverage5, gifti
from refusals import refused
from studies import write_label

import voxflat
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.methods import Voxflat


@pytest.fixture(scope="module")
def brain(tmp_path_factory):
    """Return a directory like FreeSurfer's, with lh.white, rh.pial, lh.curv, ... of fsaverage5."""
    folder = tmp_path_factory.mktemp("fsaverage5")
    for side, h in (("left", "lh"), ("right", "rh")):
        for name, of in (("white", "white"), ("pial", "pial"), ("infl", "inflated"), ("sphere", "sphere")):
            mesh = read_mesh(fsaverage5(f"{name}_{side}"))
            nib.freesurfer.write_geometry(folder / f"{h}.{of}", mesh.points, mesh.faces, "me")
        for name, of in (("curv", "curv"), ("sulc", "sulc"), ("thick", "thickness")):
            values = nib.load(fsaverage5(f"{name}_{side}")).darrays[0].data
            nib.freesurfer.write_morph_data(folder / f"{h}.{of}", values)
    return folder


def mesh(brain, name):
    """Return points and triangles without a file name that shows the side."""
    return tuple(nib.freesurfer.read_geometry(brain / name))


OTHER = "belongs to the right hemisphere, but the surface belongs to the left one"


class TestPial:
    @pytest.mark.parametrize("h", ["lh", "rh"])
    def test_the_right_one(self, brain, h):
        for of in (brain.joinpath, lambda name: mesh(brain, name)):
            made = voxflat.surface(of(f"{h}.white"), pial=of(f"{h}.pial"))
            assert made.warnings == ()
            thickness = nib.freesurfer.read_morph_data(brain / f"{h}.thickness")  # FreeSurfer's own
            assert np.corrcoef(made.thickness, thickness)[0, 1] > 0.9
            assert abs(np.median(made.thickness) - np.median(thickness)) < 0.25  # FreeSurfer's is to the nearest point

    def test_the_other_side_by_its_name_and_exchanged_ones(self, brain):
        message = f"rh.pial: {OTHER}"
        refused(message, voxflat.surface, brain / "lh.white", pial=brain / "rh.pial")
        message = r"lies inside the given surface: .*whether the two are swapped"
        refused(message, voxflat.surface, brain / "lh.pial", pial=brain / "lh.white")

    WRONG = (("lh.white", "rh.pial"), ("lh.white", "rh.white"), ("lh.white", "lh.inflated"), ("lh.white", "lh.sphere"))
    WRONG += (("rh.white", "lh.pial"), ("lh.pial", "lh.inflated"))

    @pytest.mark.parametrize(("white", "pial"), WRONG)
    def test_wrong_ones_by_geometry(self, brain, white, pial):
        message = (
            r"does not match the given surface: .* mm, and on balance \d+ % of the way there leads (?:in|out)wards"
        )
        refused(message, voxflat.surface, mesh(brain, white), pial=mesh(brain, pial))

    @pytest.mark.parametrize("unit", [1.0, 0.001, 1000.0])
    def test_whatever_the_unit(self, brain, unit):
        (white, faces), (pial, _), (other, _) = (mesh(brain, name) for name in ("lh.white", "lh.pial", "rh.pial"))
        surface = voxflat.surface((unit * white, faces), pial=(unit * pial, faces))
        assert not any("pial" in warning for warning in surface.warnings)
        refused("does not match", voxflat.surface, (unit * white, faces), pial=(unit * other, faces))

    def test_shifted(self, brain):
        """A shift by a typical c_ras raises an error, and a shift by 2.4 mm a warning."""
        (white, faces), (pial, _) = (mesh(brain, name) for name in ("lh.white", "lh.pial"))
        shifted = pial + np.array([3, -17, 22]), faces
        refused("same hemisphere, subject and space", voxflat.surface, (white, faces), pial=shifted)
        (warning,) = voxflat.surface((white, faces), pial=(pial + np.array([1, -2, 1]), faces)).warnings
        assert "may not match the given surface" in warning

    def test_itself(self, brain):
        same = voxflat.surface(brain / "lh.white", pial=brain / "lh.white")
        (warning,) = same.warnings
        assert "the pial surface equals the given surface: distances are measured on it" in warning
        assert same.metadata["measured_on"] == "the given surface"

    def test_a_patch_that_faces_inwards_is_no_error(self, brain):
        """The outside of a surface with a boundary is not known."""
        (white, faces), (pial, _) = (mesh(brain, name) for name in ("lh.white", "lh.pial"))
        part = faces[(white[faces][:, :, 2] > 40).all(axis=1)][:, ::-1]
        (warning,) = [told for told in voxflat.surface((white, part), pial=(pial, part)).warnings if "pial" in told]
        assert "may not match" in warning


class TestLabels:
    def cut(self, brain, label, white="lh.white"):
        return voxflat.surface(brain / white if isinstance(white, str) else white).keep(label).cut(relax=False)

    def chosen(self, brain, name):
        """Return the vertices within 25 mm of a point, and the positions of all vertices."""
        points = mesh(brain, name)[0]
        return np.flatnonzero(np.linalg.norm(points - points[2000], axis=1) < 25), points

    @pytest.mark.parametrize("drawn_on", ["lh.white", "lh.pial", "nothing", "no columns"])
    def test_its_own(self, brain, tmp_path, drawn_on):
        vertices, white = self.chosen(brain, "lh.white")
        points = 0 * white if "." not in drawn_on else mesh(brain, drawn_on)[0]
        write_label(path := tmp_path / "lh.V1.label", vertices, points)
        if drawn_on == "no columns":
            path.write_text("\n".join(["#!ascii label", str(len(vertices)), *map(str, vertices)]))
        assert not any("label" in warning for warning in self.cut(brain, path).warnings)

    def test_the_other_sides(self, brain, tmp_path):
        vertices, white = self.chosen(brain, "rh.white")
        write_label(path := tmp_path / "rh.V1.label", vertices, white)
        refused(
            rf"rh\.V1\.label: {OTHER}",
            self.cut,
            brain,
            path,
        )
        path = path.rename(tmp_path / "V1.label")  # now only its points tell
        refused(r"V1\.label: .* lie on opposite sides of the brain \(mean x: \d+ and -\d+", self.cut, brain, path)

    def test_of_another_surface(self, brain, tmp_path):
        """A label of another surface only causes a warning, because the surface may be inflated."""
        vertices, white = self.chosen(brain, "lh.white")
        write_label(path := tmp_path / "V1.label", vertices, white[::-1])
        warnings = [warning for warning in self.cut(brain, path).warnings if "V1.label" in warning]
        assert len(warnings) == 1
        assert "mm (median) away from the vertices to which it refers" in warnings[0]

    def test_on_a_surface_in_scanner_ras(self, brain, tmp_path):
        """The points of the label are in tkRAS although the surface is not, and c_ras is unknown."""
        vertices, white = self.chosen(brain, "lh.white")
        write_label(path := tmp_path / "V1.label", vertices, white)
        points, faces = mesh(brain, "lh.white")
        warnings = self.cut(brain, path, (points + np.array([3, -17, 22]), faces)).warnings
        assert not any("label" in warning for warning in warnings)


class TestOverlays:
    @pytest.fixture(scope="class")
    def flat(self, brain):
        return voxflat.surface(brain / "lh.white").disk(2000, 60.0).flatten(Voxflat(sources=30))

    @pytest.mark.medium
    @pytest.mark.parametrize("name", ["curv", "sulc", "thickness"])
    def test_its_own(self, flat, brain, caplog, name):
        with caplog.at_level(logging.WARNING, logger="voxflat"):
            image = flat.image(brain / f"lh.{name}")
        assert caplog.messages == []
        assert np.isfinite(image.data).any()

    @pytest.mark.medium
    @pytest.mark.parametrize("name", ["curv", "sulc", "thickness"])
    def test_the_other_sides(self, flat, brain, name):
        message = rf"rh\.{name}: {OTHER}. Pass .* array"
        refused(message, flat.image, brain / f"rh.{name}")
        values = nib.freesurfer.read_morph_data(brain / f"rh.{name}")
        assert np.isfinite(flat.image(values).data).any()  # what is meant is taken

    def test_gifti_says_it_itself(self, flat, tmp_path):
        values = [(np.zeros(10242, "f4"), "shape")]
        right = {"AnatomicalStructurePrimary": "CortexRight"}
        for change in (lambda image: image.meta.update(right), lambda image: image.darrays[0].meta.update(right)):
            refused("belongs to the right hemisphere", flat.image, gifti(tmp_path / "lh.shape.gii", values, change))
        flat.image(gifti(tmp_path / "x.shape.gii", values))

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["curv", "sulc"])
    def test_another_surfaces_folds(self, flat, brain, tmp_path, caplog, name):
        """The overlay has the right number of vertices, but belongs to the other side, which its name does not show."""
        other = tmp_path / f"bert.{name}"
        other.write_bytes((brain / f"rh.{name}").read_bytes())
        flat.image(other)
        assert f"bert.{name} does not follow the folds of the surface: its correlation with the curv" in caplog.text
        caplog.clear()
        page = voxflat.surface(brain / "lh.white").patches(30.0).page()
        page.image(other)
        assert "does not follow the folds" in caplog.text
        caplog.clear()
        page.image(brain / f"lh.{name}")
        assert caplog.messages == []

    @pytest.mark.medium
    def test_another_subjects_by_its_name(self, brain, tmp_path, caplog):
        (tmp_path / "sub-01").mkdir()
        points, faces = mesh(brain, "lh.white")
        write_mesh(tmp_path / "sub-01" / "lh.white", Mesh(points, faces))
        flat = voxflat.surface(tmp_path / "sub-01" / "lh.white").disk(2000, 20.0).flatten(Voxflat(sources=20))
        warning = "sub-02_thickness.txt belongs to sub-02, but the surface belongs to sub-01. Check the file"
        for name, told in (("sub-01_thickness.txt", []), ("thickness.txt", []), ("sub-02_thickness.txt", [warning])):
            np.savetxt(tmp_path / name, np.zeros(len(points)))
            flat.image(tmp_path / name)
            assert caplog.messages == told

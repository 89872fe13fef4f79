"""tsgdd mesh voxels: surfaces and labelled images become meshes; files from strangers become one line."""

from __future__ import annotations

import re
import struct

import meshio
import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from meshes.labels import nearest_labels

ONE = MPI.COMM_SELF


def sphere(rings):
    """Triangles of a unit sphere: points (n, 3), triangles (t, 3), and the volume that they hold."""
    theta, phi = np.linspace(0, np.pi, rings + 1)[1:-1], np.arange(2 * rings) * np.pi / rings
    ring = np.stack(np.broadcast_arrays(np.sin(theta)[:, None] * np.cos(phi), np.sin(theta)[:, None] * np.sin(phi),
                                        np.cos(theta)[:, None]), axis=-1)  # fmt: skip
    points = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    k, n = np.arange(2 * rings), 2 * rings
    after, last = (k + 1) % n, (rings - 2) * n
    bands = [np.concatenate([np.stack([i * n + k, (i + 1) * n + k, (i + 1) * n + after], 1),
                             np.stack([i * n + k, (i + 1) * n + after, i * n + after], 1)])
             for i in range(rings - 2)]  # fmt: skip
    caps = [np.stack([np.full(n, n * (rings - 1)), k, after], 1),
            np.stack([np.full(n, n * (rings - 1) + 1), last + after, last + k], 1)]  # fmt: skip
    triangles = np.concatenate(bands + caps)
    return points, triangles, float(np.linalg.det(points[triangles]).sum() / 6)


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_a_sphere_is_filled_to_its_volume(suffix, tsgdd, read_summary, is_png, tmp_path):
    pytest.importorskip("pyvista", exc_type=ImportError)
    points, triangles, volume = sphere(24)
    meshio.write_points_cells(tmp_path / f"ball.{suffix}", 0.2 * points, [("triangle", triangles)])
    out = tmp_path / "new" / "ball.msh"
    done = tsgdd(
        "mesh", "voxels", "--surface", tmp_path / f"ball.{suffix}", "--unit", "mm", "--size", "20um", "--out", out
    )
    assert done.code == 0, done.err
    summary = read_summary(out)
    assert summary["volume"] == pytest.approx(volume * 2e-4**3, rel=0.02)
    assert summary["volume_ratio"] == pytest.approx(summary["volume"] / (volume * 2e-4**3), rel=1e-6)
    assert (summary["parts"], summary["dropped_voxels"]) == (1, 0)
    assert is_png(out.with_suffix(".png"))
    body = dd.read_msh(out, ONE)
    assert body.global_cells == summary["voxels"] == summary["regions"]["body"]
    assert dd.StrainOperator(body).weights.sum() == pytest.approx(summary["volume"], rel=1e-9)
    centre = body.mesh.geometry.x[dd.compat.geometry_nodes(body.mesh)].mean(axis=1)
    assert np.linalg.norm(centre, axis=1).max() <= 2e-4
    np.testing.assert_allclose(body.extent("surface")[0], -body.extent("surface")[1], atol=1e-9)


def test_labels_of_a_stack_become_regions(tsgdd, read_summary, is_png, tmp_path):
    tifffile = pytest.importorskip("tifffile", exc_type=ImportError)
    stack = np.zeros((4, 6, 12), dtype=np.uint16)  # z, y, x; pixels of 5 x 10 x 10 µm
    stack[:, 1:5, 2:10], stack[:2, 1:5, 2:4], stack[3, 0, :2] = 1, 9, 5
    tifffile.imwrite(tmp_path / "organ.tif", stack, compression="zlib", photometric="minisblack")
    out, scene = tmp_path / "organ.msh", ("--size", "10um", "--spacing", "5um", "10um", "1e-5")
    done = tsgdd("mesh", "voxels", "--labels", tmp_path / "organ.tif", *scene, "--out", out)
    assert done.code == 0, done.err
    assert "2 parts are not joined by faces; kept the largest" in done.out
    summary = read_summary(out)
    assert summary["regions"] == {"label-1": 4 * 4 * 4 - 8, "label-9": 8}
    assert summary["dropped_voxels"] == 1
    assert is_png(out.with_suffix(".png"))
    body = dd.read_msh(out, ONE)
    low, high, _ = body.extent("surface")
    np.testing.assert_allclose([low, high], [[1e-5, 1e-5, 0], [5e-5, 5e-5, 4e-5]], atol=1e-15)
    x = body.mesh.geometry.x[dd.compat.geometry_nodes(body.mesh)[body.regions["label-9"]]].mean(axis=1)
    assert (x[:, 0] < 2e-5).all()
    assert (x[:, 2] < 2e-5).all()


def test_nearest_labels_of_other_spacings():
    labels = np.arange(1, 25).reshape(4, 3, 2)
    assert np.array_equal(nearest_labels(labels, (2.0, 2.0, 2.0), (4, 3, 2), edge=2.0), labels)
    fine = nearest_labels(labels, (2.0, 2.0, 2.0), (8, 6, 4), edge=1.0)
    assert np.array_equal(fine, labels.repeat(2, 0).repeat(2, 1).repeat(2, 2))
    beyond = nearest_labels(labels, (1.0, 1.0, 1.0), (6, 3, 2), edge=1.0)
    assert np.array_equal(beyond[1:-1], labels)
    assert not beyond[[0, -1]].any()


def ball_file(name, change=lambda points, triangles: (points, triangles)):
    def write(folder):
        points, triangles, _ = sphere(6)
        points, triangles = change(0.1 * points, triangles)
        meshio.write_points_cells(folder / name, points, [("triangle", triangles)])
        return ("--surface", folder / name, "--unit", "mm", "--size", "20um")

    return write


def with_nan(points, triangles):
    return np.where(np.arange(len(points))[:, None] == 3, np.nan, points), triangles


def content(name, data, *options):
    def write(folder):
        (folder / name).write_bytes(data)
        return (*options, folder / name)

    return write


def image(change):
    def write(folder):
        tifffile = pytest.importorskip("tifffile", exc_type=ImportError)
        tifffile.imwrite(folder / "a.tif", change(np.ones((6, 7, 8), dtype=np.uint8)), photometric="minisblack")
        return ("--labels", folder / "a.tif", "--size", "1um", "--spacing", *3 * ("1um",))

    return write


def tiff(width, following=0):
    """One page of width x width bytes, of which ten are there, and the place of the next page."""
    tags = [(256, 4, width), (257, 4, width), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1),
            (278, 4, width), (279, 4, 10)]  # fmt: skip
    rows = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    return struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + rows + struct.pack("<I", following)


STL = ("--unit", "mm", "--size", "20um", "--surface")
TIF = ("--size", "1um", "--spacing", "1um", "1um", "1um", "--labels")
PLY = b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (ball_file("a.stl", lambda p, t: (p, t[:-1])), "expected a closed surface, got 3 open edges of"),
        (ball_file("a.ply", with_nan), "a.ply: expected finite coordinates"),
        (ball_file("a.stl", with_nan), "a.stl: expected finite coordinates"),
        (ball_file("a.stl", lambda p, t: (1e4 * p, t)), "GB of memory"),
        (ball_file("a.stl", lambda p, t: (1e12 * p, t)), "look at the size and the unit"),
        (ball_file("a.stl", lambda p, t: (1e-3 * p, t)), "size: expected at most the extent of the body, 2e-07 m"),
        (content("a.stl", bytes(80) + struct.pack("<I", 4_000_000_000) + bytes(500), *STL), "damaged .a binary STL"),
        (content("a.stl", b"solid x\n facet normal a b c\n", *STL), "damaged .ValueError could not convert"),
        (content("a.stl", b"", *STL), "damaged .* got 0.$"),
        (content("a.ply", PLY % 3, *STL), "header of PLY that ends in end_header"),
        (content("a.ply", PLY % 10**12 + b"end_header\n", *STL), "damaged .1000000000000 of vertex, in"),
        (content("a.obj", b"v 0 0 0\nf 1 2 3\n", *STL), "damaged .a triangle of point 3, of 1"),
        (content("a.obj", b"v 0 0 0\n", *STL), "expected triangles, got none"),
        (content("a.vtk", b"", *STL), "expected a file .stl, .ply or .obj"),
        (content("a.stl", b"", "--unit", "inch", "--size", "20um", "--surface"), "expected one of m, mm, um, nm"),
        (content("a.stl", b"", "--unit", "mm", "--size", "20 Pa", "--surface"), "size: expected a length"),
        (content("a.stl", b"", "--unit", "mm", "--size", "-3um", "--surface"), "size: expected a .*got '?-3um"),
        (content("a.stl", b"", "--unit", "mm", "--size", "0", "--surface"), "size: expected a .*got '?0"),
        (content("a.stl", b"", "--unit", "mm", "--size", "nan", "--surface"), "size: expected a .*got '?nan"),
        (content("a.stl", b"", "--size", "20um", "--surface"), "surface: expected --unit"),
        (lambda folder: ("--size", "20um"), "expected one of them, --surface FILE.stl or --labels FILE.tif"),
        (lambda folder: (*STL, folder / "none.stl"), "no such file"),
        (image(lambda a: 0 * a), "expected labels above 0, got none"),
        (image(lambda a: a.astype(np.float32)), "expected one stack of whole numbers"),
        (image(lambda a: np.stack([a] * 5)), "expected one stack of whole numbers .* 5 x 6 x 7 x 8"),
        (image(lambda a: np.arange(1, 337 * 4 + 1).astype(np.uint16)[:1152].reshape(8, 12, 12)), "at most 1000"),
        (content("a.tif", b"no image", *TIF), "cannot be read as TIFF"),
        (content("a.tif", tiff(4_000_000_000), *TIF), "4000000000 x 4000000000 x 1 pixels need about"),
        (content("a.tif", tiff(100, following=8), *TIF), "a.tif: (damaged|cannot be read)"),
        (content("a.tif", tiff(100), *TIF), "(damaged|cannot be read as TIFF)"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line_and_leaves_nothing(files, message, tsgdd, tmp_path):
    pytest.importorskip("pyvista", exc_type=ImportError)
    arguments = files(tmp_path)
    before = set(tmp_path.iterdir())
    done = tsgdd("mesh", "voxels", *arguments, "--out", tmp_path / "out.msh")
    assert (done.code, done.err.count("\n")) == (2, 1), done.err
    assert re.search(message, done.err), done.err
    assert set(tmp_path.iterdir()) == before

"""Scenes on unstructured meshes as their author meets them: filling, sides, what is told, checkpoints, threads and ranks.

What the methods do on meshes is tested elsewhere; the refusals are in tests/bad_inputs.
"""
import sys

import numpy as np
import pytest

from conftest import REPOSITORY, check_same, on_threads, run_in_parts, text_of, with_checkpoints

h5py = pytest.importorskip("h5py")
sys.path.insert(0, str(REPOSITORY / "preprocessing"))
import mesh_makers  # noqa: E402
from mesh_files import write_mesh  # noqa: E402
from mesh_measures import volumes  # noqa: E402

SCENE = """
&scene dimension = 2 /
&mesh file = "box.h5" /
&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e6 poisson_ratio = 0.3 /
&body name = "block" material = "rubber" shape = "elements" group = "left" velocity = 2.0, 0.5 /
&body name = "disk" material = "rubber" shape = "sphere" center = 1.5, 0.5 radius = 0.3 velocity = 4.0, 0.0 /
&boundary side = "x_high" condition = "free" leaving = "remove" /
&boundary side = "y_low" condition = "slip" /
&boundary side = "y_high" condition = "slip" /
&load kind = "gravity" acceleration = 0.0, -9.81 /
&load kind = "pressure" side = "x_low" pressure = 1.0e3 /
&time end = 0.2 /
&method basis = "linear" /
&output name = "box" every = 0.05 history_every = 5 fields = "velocity", "volume", "mass", "id", "body" /
"""
QUADS_AND_TRIANGLES = {"method.basis": "cpdi2", "method.particle_domain": "simplex"}


def write_box(folder, cells=(16, 8), name="box.h5", half=1.0, **changes):
    """Quads, and triangles in the right half; what is left and right of `half` are groups of elements. Returns the mesh"""
    mesh = mesh_makers.hybrid([0.0, 0.0], [2.0, 1.0], cells, 0.5)
    mesh.element_groups = ["left", "right"]
    mesh.groups = {kind: 1 + (mesh.nodes[table].mean(axis=1)[:, 0] > half) for kind, table in mesh.elements.items()}
    for key, value in changes.items():
        setattr(mesh, key, value)
    write_mesh(folder / name, mesh)
    return mesh


@pytest.mark.parametrize("keys", [{}, QUADS_AND_TRIANGLES, {"method.basis": "cpdi"}], ids=["linear", "cpdi2", "cpdi"])
def test_bodies_from_elements_hold_their_volume(run_scene, tmp_path, keys):
    """The volume of a body is that of its elements, kind by kind; particles are numbered in the order of the file"""
    mesh = write_box(tmp_path)
    run = run_scene(text_of(SCENE, 1, **{"body[1].group": None, "body[2].operation": "subtract", "body[2].material": None,
                                         "body[2].velocity": None, "body[2].center": [9.0, 9.0], **keys}), tmp_path).succeeded()
    frame = run.last_frame
    wanted = sum(volumes(kind, mesh.nodes[table]).sum() for kind, table in mesh.elements.items())
    assert abs(wanted - 2.0) < 1e-12
    assert np.sum(frame["mass"], dtype=float) == pytest.approx(2000.0, rel=1e-6)  # frames are in single precision
    pieces = {"quad4": 8, "triangle3": 4} if keys == QUADS_AND_TRIANGLES else {"quad4": 4, "triangle3": 4}
    assert len(frame["id"]) == sum(pieces[kind]*len(table) for kind, table in mesh.elements.items())
    order = np.argsort(frame["id"])
    centres = np.vstack([np.repeat(mesh.nodes[table].mean(axis=1), pieces[kind], axis=0)
                         for kind, table in sorted(mesh.elements.items(), key=lambda item: -len(item[0]))])  # triangle3 before quad4
    assert np.abs(frame["points"][order][:, :2] - centres).max() < 0.1  # an element is 0.125 wide


def test_groups_and_shapes_share_the_mesh(run_scene, tmp_path):
    """A later shape takes what elements leave, as it does with other shapes; each body has its momentum"""
    write_box(tmp_path)
    run = run_scene(text_of(SCENE, 1, **{"body[2].center": [1.0, 0.5]}), tmp_path).succeeded()
    frame = run.last_frame
    mass = [np.sum(frame["mass"][frame["body"] == body], dtype=float) for body in (1, 2)]
    assert mass[0] == pytest.approx(1000.0, rel=1e-6)
    assert mass[1] == pytest.approx(0.5*1000.0*np.pi*0.3**2, rel=0.05)  # half a disk of lattice points, 0.3/0.065 of them to the rim
    assert frame["points"][frame["body"] == 2][:, 0].min() > 1.0


def test_what_is_told(run_scene, tmp_path):
    """Header, closing table and summary know the mesh and the search; sides without a name can have a condition with all others"""
    mesh = write_box(tmp_path, side_group=None, sides=None, side_groups=[])
    named = [line for line in SCENE.splitlines() if not line.startswith("&boundary") and "side =" not in line]
    run = run_scene("\n".join(named) + '\n&boundary side = "all" condition = "slip" /\n', tmp_path).succeeded()
    text = run.stdout
    assert "mesh       box.h5: " in text and " triangle3 and " in text and " quad4, " in text
    assert "sides      (no name) (48): slip" in text
    summary = run.summary
    assert summary["mesh_nodes"] == len(mesh.nodes) and summary["mesh_elements"] == mesh.count()
    leaves, visits = summary["search_leaves"], summary["search_visits"]
    assert 0.0 < leaves < 0.1 and 1.0 <= visits <= 1.0 + 1.2*leaves + 1e-12
    assert summary["search_by_velocity"] + summary["search_by_walk"] + summary["search_by_rings"] == pytest.approx(1.0)
    assert len(summary["mesh_hash"]) == 16
    assert f"{visits:.4g} elements asked for" in text.replace("1 elements", "1. elements")


def test_free_sides(run_scene, tmp_path):
    """What leaves where a side removes is counted and gone; where nothing is said the run fails and names the particle"""
    write_box(tmp_path)
    run = run_scene(SCENE, tmp_path).succeeded()
    assert "x_high (8): free, removes" in run.stdout and "y_low (16): slip" in run.stdout
    removed = run.summary["removed_particles"]
    assert removed > 0
    assert run.summary["particles"] == len(run.last_frame["id"])
    stops = run_scene(SCENE.replace(' leaving = "remove"', ""), tmp_path, output__overwrite=True)
    assert stops.code == 1 and "particle" in stops.stderr


def test_a_checkpoint_knows_its_mesh(run_scene, tmp_path):
    """The file may have another name and place; another content is refused"""
    write_box(tmp_path)
    total = run_scene(SCENE, tmp_path).succeeded().summary["steps"]
    whole = (tmp_path / "box.vtkhdf").rename(tmp_path / "whole.vtkhdf")
    rest = run_in_parts(run_scene, tmp_path, SCENE, int(total)//2, int(total), (1, 2))
    check_same(whole, rest.output)
    run_scene(with_checkpoints(text_of(SCENE, 20, **{"output.overwrite": True}), every_steps=10), tmp_path).succeeded()
    write_box(tmp_path, name="moved.h5")
    moved = SCENE.replace('"box.h5"', '"moved.h5"')
    again = run_scene(moved, tmp_path, arguments=("--check", "--restart", "box.checkpoint.h5"))
    assert again.code == 0, again.stderr
    for other in ({"half": 0.9}, {"cells": (16, 9)}):
        write_box(tmp_path, name="moved.h5", **other)
        refused = run_scene(moved, tmp_path, arguments=("--restart", "box.checkpoint.h5"))
        assert refused.code == 2 and "is a checkpoint on another mesh: moved.h5" in refused.stderr


@pytest.mark.parametrize("keys", [{}, QUADS_AND_TRIANGLES], ids=["linear", "cpdi2"])
def test_same_bits_on_threads_and_ranks(run_scene, run_ranks, tmp_path, keys):
    """Elements are found and filled by shares; nothing shows it"""
    folders = [tmp_path / name for name in ("one", "two", "ranks")]
    for folder in folders:
        folder.mkdir()
        write_box(folder)
    text = text_of(SCENE, 40, **keys)
    one = run_scene(text, folders[0]).succeeded()
    check_same(one.output, run_scene(on_threads(text, 2), folders[1]).succeeded().output)
    check_same(one.output, run_ranks(text, folders[2], 3).succeeded().output)

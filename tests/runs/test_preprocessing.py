"""The scripts of preprocessing/: meshes made and converted, bodies filled; gimp.x is not needed."""
import math
import subprocess
import sys

import pytest

h5py = pytest.importorskip("h5py")
np = pytest.importorskip("numpy")

from conftest import REPOSITORY  # noqa: E402

SCRIPTS = REPOSITORY / "preprocessing"
MESHES = sorted((REPOSITORY / "inputs" / "meshes").glob("*.h5"))
sys.path.insert(0, str(SCRIPTS))

import make_mesh  # noqa: E402
import mesh_files as mf  # noqa: E402
import mesh_measures as measures  # noqa: E402


def made(tmp_path, *words):
    """The mesh that make_mesh.py writes"""
    path = tmp_path / "made.h5"
    assert make_mesh.main([*words, str(path)]) == 0
    return mf.read_mesh(path)


def refused(main, *words):
    """What a script says that ends with exit code 2"""
    try:
        main(list(map(str, words)))
    except mf.MeshError as problem:
        return str(problem)
    except SystemExit as end:  # argparse has printed it
        assert end.code == 2
        return "usage"
    pytest.fail("not refused")


def content(mesh):
    """Area or volume of a mesh"""
    return sum(measures.volumes(kind, mesh.nodes[table]).sum() for kind, table in mesh.elements.items())


def length_of_sides(mesh, sides):
    """Length (2D) or area (3D) of straight sides, (n,)"""
    x = mesh.nodes[sides]
    if mesh.dim == 2:
        return np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    found = 0.5*np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    found[sides[:, 3] >= 0] += (0.5*np.linalg.norm(np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 0]), axis=1))[sides[:, 3] >= 0]
    return found


# ------------------------------------------------------------------------------------------- elements


@pytest.mark.parametrize("kind", mf.KINDS)
def test_shape_functions_are_one_at_their_node_and_sum_to_one(kind):
    here = measures.natural_nodes(kind)
    points, _ = measures.quadrature(kind)
    np.testing.assert_allclose(measures.shape_values(kind, here), np.eye(len(here)), atol=1e-14)  # round-off of small matrices
    np.testing.assert_allclose(measures.shape_values(kind, points).sum(1), 1, atol=1e-14)
    np.testing.assert_allclose(measures.shape_slopes(kind, points).sum(1), 0, atol=1e-14)


@pytest.mark.parametrize("kind", mf.KINDS)
def test_turning_an_element_changes_the_sign_of_its_volume(kind):
    here = measures.natural_nodes(kind)
    chance = np.random.RandomState(1)
    x = here + 0.1*chance.standard_normal(here.shape)
    volume = measures.volumes(kind, x[None])[0]
    assert volume > 0 and measures.qualities(kind, x[None])[0] > 0
    turned = x[list(mf.KINDS[kind].turned)][None]
    assert measures.volumes(kind, turned)[0] == pytest.approx(-volume, rel=1e-12)
    assert measures.qualities(kind, turned)[0] < 0


@pytest.mark.parametrize("kind", mf.KINDS)
def test_sides_look_outward(kind):
    here = measures.natural_nodes(kind)
    sides = mf.KINDS[kind].sides
    middle = here.mean(0)
    for side in sides:
        x = here[list(side)]
        if here.shape[1] == 2:
            (dx, dy) = x[1] - x[0]
            normal = np.array([dy, -dx])
        elif here.shape[1] == 3:
            normal = np.cross(x[1] - x[0], x[2] - x[0])
        else:
            continue
        assert normal @ (x.mean(0) - middle) > 0


# ------------------------------------------------------------------------------------------- made meshes


BOX = ("x_low", "x_high", "y_low", "y_high")
CUBE = (*BOX, "z_low", "z_high")

# words, content, length of each named side, or None where it is curved
MADE = {
    "quads": (["block", "--lower", "-1,0", "--upper", "2,1", "--cells", "6,3", "--ratio", "4,0.5", "--distort", "0.3"], 3.0, dict(zip(BOX, (1, 1, 3, 3)))),
    "quad8": (["block", "--type", "quad8", "--cells", "4,3", "--distort", "0.3"], 1.0, dict.fromkeys(BOX, 1)),
    "quad9": (["block", "--type", "quad9", "--cells", "4,3", "--distort", "0.3"], 1.0, dict.fromkeys(BOX, 1)),
    "triangle3": (["block", "--type", "triangle3", "--cells", "4,3", "--distort", "0.3"], 1.0, dict.fromkeys(BOX, 1)),
    "triangle6": (["block", "--type", "triangle6", "--cells", "4,3", "--distort", "0.3"], 1.0, dict.fromkeys(BOX, 1)),
    "intervals": (["block", "--intervals-x", "0.1,0.2,0.4", "--intervals-y", "0.5,0.25"], 0.7*0.75, dict(zip(BOX, (0.75, 0.75, 0.7, 0.7)))),
    "cubes": (["block", "--type", "hexahedron8", "--upper", "1,2,3", "--cells", "2,3,4", "--distort", "0.3"], 6.0, dict(zip(CUBE, (6, 6, 3, 3, 2, 2)))),
    "tetrahedra": (["tet_block", "--upper", "1,2,3", "--cells", "3,4,5", "--distort", "0.3"], 6.0, dict(zip(CUBE, (6, 6, 3, 3, 2, 2)))),
    "ring": (["ring", "--radii", "1,2", "--cells", "4,90"], 0.75*math.pi, dict(axis_x=1, axis_y=1, inner=math.pi/2, outer=math.pi)),
    "curved ring": (["ring", "--type", "quad9", "--radii", "1,2", "--cells", "4,9", "--angles", "-30,60"], 0.75*math.pi,
                    dict(first_ray=1, last_ray=1, inner=None, outer=None)),
    "triangles": (["triangles", "--upper", "2,1", "--size", "0.1", "--distort", "0.2"], 2.0, dict(zip(BOX, (1, 1, 2, 2)))),
    "disk": (["disk", "--radius", "2", "--center", "3,-1", "--rings", "20"], 4*math.pi, dict(rim=4*math.pi)),
    "disk in a box": (["disk", "--radius", "0.5", "--rings", "4", "--box", "1"], 4.0, dict.fromkeys(BOX, 2)),
    "ring with body": (["ring", "--radii", "0.3,0.75", "--cells", "9,12", "--body", "0.4,0.6"], 0.25*math.pi*(0.75**2 - 0.3**2),
                       dict(axis_x=0.45, axis_y=0.45, inner=0.15*math.pi, outer=0.375*math.pi)),
    "slope": (["slope", "--ratio", "2"], 20*7.5, dict(base=20, left=7.5, right=7.5, top=20)),
    "slope of triangles": (["slope", "--type", "triangle6", "--air", "0", "--distort", "0.2"], 20*2 + 4*5 + 0.5*4*4,
                           dict(base=20, left=6, right=2, crest=5, slope=4*math.sqrt(2), toe=11)),
    "layer": (["slope", "--layer", "--air", "0", "--angle", "30", "--depth", "1"], 16 + 4*math.sqrt(3),
              dict(base=24, left=1, right=1, crest=5, slope=8, toe=11)),
    "funnel": (["funnel", "--width", "1.2", "--outlet", "0.2", "--angle", "45", "--bin", "0.5", "--space", "0.4", "--space-width", "0.8"],
               0.6 + 0.35 + 0.32, dict(top=1.2, left_wall=0.5 + 0.5*math.sqrt(2), right_wall=0.5 + 0.5*math.sqrt(2), ceiling=0.6, floor=0.8,
                                       space_left=0.4, space_right=0.4)),
    "funnel alone": (["funnel", "--type", "quad9", "--width", "1.2", "--outlet", "0.2", "--angle", "45", "--bin", "0.5", "--space", "0"],
                     0.6 + 0.35, dict(top=1.2, left_wall=0.5 + 0.5*math.sqrt(2), right_wall=0.5 + 0.5*math.sqrt(2), outlet=0.2)),
    "funnel into a channel": (["funnel", "--type", "triangle3", "--width", "1.2", "--outlet", "0.2", "--angle", "45", "--bin", "0.5", "--space",
                               "0.4", "--space-width", "0.2", "--distort", "0.2"], 0.6 + 0.35 + 0.08,
                              dict(top=1.2, left_wall=0.5 + 0.5*math.sqrt(2), right_wall=0.5 + 0.5*math.sqrt(2), floor=0.2, space_left=0.4,
                                   space_right=0.4)),
    "hybrid": (["hybrid", "--upper", "2,1", "--cells", "8,4", "--distort", "0.3"], 2.0, dict(zip(BOX, (1, 1, 2, 2)))),
}


@pytest.mark.parametrize("name", MADE)
def test_made_mesh_is_whole(name, tmp_path):
    """Volumes are positive and add up, elements meet along whole sides, and the named sides are the surface of the region"""
    words, volume, lengths = MADE[name]
    mesh = made(tmp_path, *words)
    # straight sides follow a circle to (angle of a side)^2/6; curved ones to its fourth power; boxes to round-off
    tolerance = {"ring": 1e-4, "disk": 1e-3, "curved ring": 1e-5, "ring with body": 5e-3}.get(name, 1e-12)
    assert measures.faulty_elements(mesh) == []
    assert content(mesh) == pytest.approx(volume, rel=tolerance)
    outside = mf.boundary_sides(mesh)
    assert len(outside) == len(mesh.sides)  # each side has a name, and
    assert (mf.sharing(np.concatenate([outside, mesh.sides])) == 2).all()  # only they have one
    assert set(mesh.side_groups) == set(lengths)
    measured = length_of_sides(mesh, mesh.sides)
    for k, side in enumerate(mesh.side_groups, 1):
        if lengths[side] is not None:  # a gap inside the mesh would add to the boundary
            assert measured[mesh.side_group == k].sum() == pytest.approx(lengths[side], rel=tolerance)
    assert len(np.unique(mesh.nodes, axis=0)) == len(mesh.nodes)
    assert set(np.concatenate([t.ravel() for t in mesh.elements.values()])) == set(range(len(mesh.nodes)))


@pytest.mark.parametrize("words, expected", [
    (["slope"], dict(soil=20*2 + 4*5 + 0.5*4*4, air=20*5.5 - 4*5 - 0.5*4*4)),
    (["funnel", "--angle", "45"], dict(bin=0.6, hopper=0.65*0.35, space=0.6)),
    (["ring", "--radii", "0.3,0.75", "--cells", "18,90", "--body", "0.4,0.6"], dict(body=0.05*math.pi)),
    (["disk", "--radius", "0.5", "--rings", "40", "--box", "1"], dict(disk=0.25*math.pi, outside=4 - 0.25*math.pi)),
    (["hybrid", "--cells", "8,4", "--share", "0.25"], dict(quads=0.25, triangles=0.75)),
])
def test_groups_of_made_meshes(words, expected, tmp_path):
    mesh = made(tmp_path, *words)
    areas = {name: sum(measures.volumes(kind, mesh.nodes[table[mesh.groups[kind] == k]]).sum() for kind, table in mesh.elements.items()
                       if (mesh.groups[kind] == k).any()) for k, name in enumerate(mesh.element_groups, 1)}
    # curved edges follow a circle to (angle of a side)^2/6
    assert areas == pytest.approx(expected, rel=1e-12 if words[0] in ("slope", "funnel", "hybrid") else 1e-3)


def test_slope_has_nodes_on_its_surface(tmp_path):
    mesh = made(tmp_path, "slope")
    soil = mesh.elements["quad4"][mesh.groups["quad4"] == 1]
    for corner in ((0, 6), (5, 6), (9, 2), (20, 2), (7, 4)):
        assert (np.abs(mesh.nodes[np.unique(soil)] - corner).max(1) < 1e-12).any(), corner


def test_line_of_two_sides(tmp_path):
    mesh = made(tmp_path, "block", "--type", "line2", "--upper", "3", "--cells", "6", "--ratio", "2")
    lengths = np.diff(mesh.nodes[:, 0])
    assert lengths.sum() == pytest.approx(3) and lengths[-1]/lengths[0] == pytest.approx(2)
    assert mesh.sides[:, 0].tolist() == [0, 6] and mesh.side_groups == ["x_low", "x_high"]


def test_ring_stands_on_its_axes(tmp_path):
    mesh = made(tmp_path, "ring", "--cells", "3,5")
    for axis, name in ((1, "axis_x"), (0, "axis_y")):
        nodes = mesh.sides[mesh.side_group == mesh.side_groups.index(name) + 1][:, :2]
        assert (mesh.nodes[nodes][..., axis] == 0).all()  # exactly: they are planes of symmetry


def test_good_triangles(tmp_path):
    """The quality is sin(smallest angle)/sin(60)-like: 1 for equilateral ones; half ones at the ends of rows have 30 degrees"""
    for words, least in ((["triangles", "--size", "0.05"], 0.57), (["disk"], 0.8), (["disk", "--box", "2"], 0.5)):
        mesh = made(tmp_path, *words)
        assert measures.qualities("triangle3", mesh.nodes[mesh.elements["triangle3"]]).min() > least


def test_distortion_moves_inner_nodes_only_and_is_repeatable(tmp_path):
    words = ["block", "--cells", "10,10"]
    plain, one, same, other = (made(tmp_path, *words, *more) for more in
                               ([], ["--distort", "0.3"], ["--distort", "0.3", "--seed", "1"], ["--distort", "0.3", "--seed", "2"]))
    moved = np.linalg.norm(one.nodes - plain.nodes, axis=1)
    inner = ((plain.nodes > 0) & (plain.nodes < 1)).all(1)
    assert (moved[~inner] == 0).all() and (moved[inner] > 0).all() and 0.02 < moved.max() <= 0.03
    assert (one.nodes == same.nodes).all() and not np.allclose(one.nodes, other.nodes)


def test_mesh_file_comes_back_and_has_the_same_bytes_each_time(tmp_path):
    words = ["disk", "--rings", "3", "--box", "2"]
    for name in ("one.h5", "two.h5"):
        make_mesh.main([*words, str(tmp_path / name)])
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()
    mesh = make_mesh.make(make_mesh.parse_arguments([*words, "x"]))
    read = mf.read_mesh(tmp_path / "one.h5")
    assert (read.nodes == mesh.nodes).all() and (read.sides == mesh.sides).all() and (read.side_group == mesh.side_group).all()
    assert (read.elements["triangle3"] == mesh.elements["triangle3"]).all() and (read.groups["triangle3"] == mesh.groups["triangle3"]).all()
    assert (read.element_groups, read.side_groups) == (["disk", "outside"], list(BOX))
    with h5py.File(tmp_path / "one.h5") as file:
        assert file.attrs["format"] == b"gimp-mesh" and file["elements/triangle3"].dtype == np.int32
        assert file["elements/triangle3"][:].min() == 1  # numbers of the file


@pytest.mark.parametrize("path", MESHES, ids=lambda path: path.stem)
def test_meshes_of_scenes_are_those_of_their_commands(path, tmp_path):
    """The file holds the command that makes it again"""
    assert path.stat().st_size < 100_000  # bytes; they are kept with the source
    kept = mf.read_mesh(path)
    with h5py.File(path) as file:
        script, *words = file.attrs["made_by"].decode().split()
    assert script == "make_mesh.py"
    mesh = made(tmp_path, *words)
    np.testing.assert_allclose(kept.nodes, mesh.nodes, rtol=0, atol=1e-12*np.abs(mesh.nodes).max())  # sines of other machines
    assert list(kept.elements) == list(mesh.elements)
    for kind, table in mesh.elements.items():
        assert (kept.elements[kind] == table).all() and (kept.groups[kind] == mesh.groups[kind]).all()
    assert (kept.sides == mesh.sides).all() and (kept.side_group == mesh.side_group).all()
    assert (kept.element_groups, kept.side_groups) == (mesh.element_groups, mesh.side_groups)


def test_meshes_of_scenes_are_there():
    assert {path.stem for path in MESHES} >= {"slope", "ring", "triangles", "funnel", "tetrahedra", "hybrid"}


def test_make_mesh_tells_what_it_made(tmp_path):
    done = subprocess.run([SCRIPTS / "make_mesh.py", "hybrid", "--cells", "4,2", tmp_path / "h.h5"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""
    for words in ("15 nodes in 2D, 12 elements: 8 triangle3, 4 quad4", "box [0, 1] x [0, 1] m", "area 1 m2", "element group quads: 4 quad4",
                  "side x_low: 2 of 12 boundary sides"):
        assert words in done.stdout


@pytest.mark.parametrize("words, message", [
    (["block"], "--cells"),
    (["block", "--cells", "4"], "2 whole numbers"),
    (["block", "--cells", "0,4"], "usage"),
    (["block", "--type", "hexahedron8", "--cells", "4,4"], "3 whole numbers"),
    (["block", "--cells", "4,4", "--upper", "1,-1"], "above --lower"),
    (["block", "--cells", "4,4", "--upper", "1,1,1"], "3 numbers for a mesh in 2D"),
    (["block", "--cells", "4,4", "--ratio", "1,0"], "positive"),
    (["block", "--intervals-x", "0.1"], "--intervals-x, --intervals-y"),
    (["block", "--intervals-x", "0.1", "--intervals-y", "0.1", "--cells", "1,1"], "leave --cells"),
    (["block", "--cells", "4,4", "--distort", "0.7"], "usage"),
    (["ring", "--radii", "2,1", "--cells", "4,4"], "0 < inner < outer"),
    (["ring", "--angles", "0,360", "--cells", "4,4"], "less than 360"),
    (["disk", "--radius", "2", "--box", "1"], "larger than --radius"),
    (["ring", "--cells", "4,4", "--body", "1.1,1.5"], "radii of rows of nodes"),
    (["slope", "--angle", "85"], "80 degrees"),
    (["slope", "--air", "-1"], "--air"),
    (["funnel", "--outlet", "2"], "smaller than --width"),
    (["funnel", "--space-width", "0.1"], "not less than --outlet"),
    (["hybrid", "--cells", "4,4", "--share", "2"], "no quads or no triangles"),
    (["sphere"], "usage"),
])
def test_make_mesh_refuses(words, message, tmp_path):
    assert message in refused(make_mesh.main, *words, tmp_path / "x.h5")
    assert not list(tmp_path.iterdir())


def test_refusal_is_one_line_and_exit_code_2(tmp_path):
    done = subprocess.run([SCRIPTS / "make_mesh.py", "block", tmp_path / "x.h5"], capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith("make_mesh.py: --cells") and len(done.stderr.splitlines()) == 1


def broken(tmp_path, change):
    """A mesh file with something changed in it"""
    path = tmp_path / "broken.h5"
    make_mesh.main(["hybrid", "--cells", "4,2", str(path)])
    with h5py.File(path, "a") as file:
        change(file)
    return path


def set_value(name, at, value):
    def change(file):
        file[name][at] = value
    return change


@pytest.mark.parametrize("change, message", [
    (lambda file: file.attrs.__setitem__("format", "other"), "not a mesh file"),
    (lambda file: file.attrs.__setitem__("version", 2), "version 2"),
    (lambda file: file.__delitem__("nodes"), "not a complete mesh file"),
    (lambda file: file.move("elements/quad4", "elements/wedge6"), "wedge6 is not a kind"),
    (lambda file: file.move("elements/quad4", "elements/quad9"), "must be (n, 9)"),
    (set_value("elements/quad4", (1, 2), 16), "quad4 element 2 names a node"),
    (set_value("elements/quad4", (0, 0), 0), "quad4 element 1 names a node"),
    (set_value("elements/quad4_group", 3, 3), "beyond the 2 names"),
])
def test_broken_mesh_files_are_named(change, message, tmp_path):
    assert message in read_refusal(broken(tmp_path, change))


def read_refusal(path):
    with pytest.raises(mf.MeshError) as problem:
        mf.read_mesh(path)
    return str(problem.value)


def test_other_files_are_no_mesh_files(tmp_path):
    (tmp_path / "x.h5").write_text("no HDF5")
    assert "convert_mesh.py" in read_refusal(tmp_path / "x.h5")
    assert "no such file" in read_refusal(tmp_path / "y.h5")


def test_side_of_three_elements_is_named():
    mesh = mf.Mesh([(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 2)], {"triangle3": [(0, 1, 2), (1, 3, 2), (1, 4, 2)]})
    with pytest.raises(mf.MeshError, match="triangle3 element 1 and 2 others have the side with nodes 2 3"):
        mf.boundary_sides(mesh)

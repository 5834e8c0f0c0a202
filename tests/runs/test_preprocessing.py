"""The scripts of preprocessing/: meshes made and converted, bodies filled."""
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

import convert_mesh  # noqa: E402
import element_parts  # noqa: E402
import fill_body  # noqa: E402
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


def test_heights_of_simplices():
    right = np.array([[(0, 0), (4, 0), (0, 3)]], float)  # heights 4, 3 and 2.4 over an edge of 5
    assert measures.slenderness("triangle3", right)[0] == pytest.approx(2.4/5)
    corner = np.array([[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]], float)  # 1/sqrt(3) above its largest face
    assert measures.slenderness("tetrahedron4", corner)[0] == pytest.approx(1/math.sqrt(3)/math.sqrt(2))


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


@pytest.mark.parametrize("top", [3, 2**40])
def test_unique_rows_are_those_of_numpy(top):
    """Also where a row does not fit into one number"""
    rows = np.random.RandomState(1).randint(-2, 3, (500, 4))*(top//3)
    _, *expected = np.unique(rows, axis=0, return_index=True, return_inverse=True, return_counts=True)
    for one, other in zip(mf.unique_rows(rows), expected):
        assert (one == other.ravel()).all()


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
    (["disk", "--radius", "0.5", "--rings", "20", "--box", "1"], dict(disk=0.25*math.pi, outside=4 - 0.25*math.pi)),
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


# ------------------------------------------------------------------------------------------- converted meshes


def converted(tmp_path, source, *words):
    """The mesh that convert_mesh.py writes"""
    path = tmp_path / "converted.h5"
    assert convert_mesh.main([str(source), str(path), *words]) == 0
    return mf.read_mesh(path)


def counts_of(mesh):
    """Elements in each group and sides of each name"""
    groups = {name: sum(int((g == k).sum()) for g in mesh.groups.values()) for k, name in enumerate(mesh.element_groups, 1)}
    return groups, {name: int((mesh.side_group == k).sum()) for k, name in enumerate(mesh.side_groups, 1)}


@pytest.mark.parametrize("name", ["gmsh_22.msh", "gmsh_41.msh"])
def test_gmsh_file_with_physical_names(name, tmp_path, capsys):
    """Two unit squares of Gmsh 4.15: triangles called soil, quads called air, between them lines called interface"""
    pytest.importorskip("meshio")
    mesh = converted(tmp_path, REPOSITORY / "tests" / "data" / "meshes" / name)
    assert {kind: len(table) for kind, table in mesh.elements.items()} == {"triangle3": 14, "quad4": 4}
    assert measures.faulty_elements(mesh) == [] and content(mesh) == pytest.approx(2, rel=1e-11)  # Gmsh's middles of edges
    assert counts_of(mesh) == ({"soil": 14, "air": 4}, {"base": 4, "left wall": 2})
    assert (mesh.nodes[mesh.elements["triangle3"]][..., 0] <= 1).all()
    base, left = (mesh.nodes[mesh.sides[mesh.side_group == k][:, :2]] for k in (1, 2))
    assert (base[..., 1] == 0).all() and (left[..., 0] == 0).all()
    told = capsys.readouterr().out
    assert "left out of side interface: 2 of 2" in told and "without a name: 6 of 12 boundary sides" in told


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".msh", ".22.msh", ".mesh"])
@pytest.mark.parametrize("words", [["hybrid", "--cells", "6,3", "--distort", "0.2"], ["block", "--type", "hexahedron8", "--cells", "3,2,2"],
                                   ["tet_block", "--cells", "2,2,2"], ["block", "--type", "quad8", "--cells", "3,2"],
                                   ["block", "--type", "quad9", "--cells", "3,2"], ["block", "--type", "triangle6", "--cells", "3,2"]])
def test_there_and_back(words, suffix, tmp_path):
    """Meshes written by meshio come back with all nodes of all elements in their places"""
    meshio = pytest.importorskip("meshio")
    if suffix == ".msh" and "hybrid" in words:
        pytest.skip("meshio writes Gmsh 4.1 only with one kind of elements; tests/data/meshes has such a file of Gmsh")
    if suffix == ".mesh" and {"quad8", "quad9", "triangle6"} & set(words):
        pytest.skip("Medit files have linear elements only")
    mesh = made(tmp_path, *words)
    names = {kind: name for name, kind in convert_mesh.KIND_OF.items()}
    points = np.zeros((len(mesh.nodes) + 1, 3))  # one that no element has
    points[:-1, :mesh.dim] = mesh.nodes
    path = tmp_path / f"x{suffix}"
    meshio.Mesh(points, [(names[kind], table) for kind, table in mesh.elements.items()]).write(
        path, **({"file_format": "gmsh22" if "22" in suffix else "gmsh"} if "msh" in suffix else {}))
    back = converted(tmp_path, path)
    assert list(back.elements) == list(mesh.elements) and len(back.nodes) == len(mesh.nodes)
    for kind, table in mesh.elements.items():
        np.testing.assert_allclose(back.nodes[back.elements[kind]], mesh.nodes[table], atol=1e-14)  # some files hold decimal numbers


def test_numbers_of_groups_from_vtk(tmp_path):
    meshio = pytest.importorskip("meshio")
    mesh = made(tmp_path, "block", "--cells", "3,1")
    meshio.Mesh(mesh.nodes, [("quad", mesh.elements["quad4"])], cell_data={"material": [np.array([0, 7, 7])]}).write(tmp_path / "x.vtu")
    assert counts_of(converted(tmp_path, tmp_path / "x.vtu", "--groups-from", "material"))[0] == {"material_7": 2}
    assert "there are: material" in refused(convert_mesh.main, tmp_path / "x.vtu", tmp_path / "o.h5", "--groups-from", "colour")


ABAQUS = """*HEADING
 a square of two triangles beside one of a quad
** comment
*Node, NSET=all
10, 0., 0.
20, 1., 0.
30, 2., 0.
11, 0., 1.
21, 1., 1.
31, 2., 1.
99, 5., 5.
*Element, type=CPE3, elset=soft
1, 10, 20, 21
2, 10, 21, 11
*Element, type=CPE4R
5, 20, 30, 31, 21
*Element, type=T2D2, elset=base
7, 10, 20
8, 20, 30
*Elset, elset=stiff, generate
5, 6, 1
*Elset, elset=everything
soft, 5
*Nset, nset=right_nodes
30, 31
*Surface, type=ELEMENT, name=top
2, S2
stiff, S3
*Material, name=steel
*Elastic
1.0, 0.3
*End
"""


def test_abaqus_file_with_sets_and_surfaces(tmp_path, capsys):
    source = tmp_path / "x.inp"
    source.write_text(ABAQUS)
    mesh = converted(tmp_path, source, "--ignore", "everything", "--node-sets", "right_nodes", "--scale", "0.001")
    assert mesh.nodes.tolist() == [[0, 0], [0.001, 0], [0.002, 0], [0, 0.001], [0.001, 0.001], [0.002, 0.001]]
    assert {kind: (table + 1).tolist() for kind, table in mesh.elements.items()} == \
        {"triangle3": [[1, 2, 5], [1, 5, 4]], "quad4": [[2, 3, 6, 5]]}
    assert counts_of(mesh) == ({"soft": 2, "stiff": 1}, {"base": 2, "top": 2, "right_nodes": 1})
    top = mesh.sides[mesh.side_group == mesh.side_groups.index("top") + 1]
    assert sorted(map(sorted, (top[:, :2] + 1).tolist())) == [[4, 5], [5, 6]]
    told = capsys.readouterr().out
    assert "left out: 1 nodes that no element has" in told and "left out: sets of nodes all" in told
    only = converted(tmp_path, source, "--only", "everything")
    assert counts_of(only) == ({"everything": 3}, {})


@pytest.mark.parametrize("change, words, message", [
    (("", ""), [], "2 triangle3 elements are in the groups soft and everything (the first: 1)"),
    (("", ""), ["--only", "none"], "--only none: no such group; there are: base everything soft stiff top"),
    (("", ""), ["--only", "soft", "--node-sets", "none"], "there are: all right_nodes"),
    (("1, 10, 20, 21", "1, 10, 21, 20"), ["--only", "soft"], "1 triangle3 elements have a negative volume (--fix-orientation turns them around): 1"),
    (("21, 1., 1.", "21, 1.9, 0.05"), ["--only", "soft", "--fix-orientation"], "1 quad4 elements are twisted"),
    (("21, 1., 1.", "21, 1.49, 0.5"), ["--only", "soft"], "1 quad4 elements are needles or nearly twisted"),
    (("21, 1., 1.", "21, 1., 0.008"), ["--only", "soft"], "1 triangle3 elements are needles or nearly twisted"),
    (("1, 10, 20, 21", "1, 10, 20, 20"), ["--only", "soft"], "1 triangle3 elements have no volume: 1"),
    (("5, 20, 30, 31, 21", "5, 20, 30, 31, 77"), [], "line 16: an element of CPE4R with a node that is not there: 77"),
    (("5, 20, 30, 31, 21", "5, 20, 30, 31"), [], "line 16: the last element of CPE4R has 3 nodes"),
    (("30, 2., 0.", "20, 2., 0."), [], "line 7: node 20 was there before"),
    (("2, S2", "2, S4"), [], "line 27: surface top: element 2 has no side S4"),
    (("21, 1., 1.", "21, 1., 1., 1."), ["--only", "soft"], "surfaces in space, z from 0 to 1"),
    (("CPE4R", "XYZ4"), [], "1 XYZ4, which gimp.x does not have"),
    (("soft, 5", "hard, 5"), [], "a set names 'hard'"),
    (("*HEADING", "*INCLUDE, INPUT=other.inp"), [], "line 1: *INCLUDE"),
    (("2, 10, 21, 11", "2, 10, 21, 11\n3, 11, 10, 21\n4, 21, 11, 10"), ["--only", "soft"], "at most two may share one"),
])
def test_abaqus_file_is_refused(change, words, message, tmp_path):
    source = tmp_path / "x.inp"
    assert change[0] in ABAQUS
    source.write_text(ABAQUS.replace(*change, 1) if change[0] else ABAQUS)
    assert message in refused(convert_mesh.main, source, tmp_path / "o.h5", *words)
    assert not (tmp_path / "o.h5").exists()


def test_turned_elements_are_turned_around(tmp_path, capsys):
    source = tmp_path / "x.inp"
    source.write_text(ABAQUS.replace("5, 20, 30, 31, 21", "5, 21, 31, 30, 20"))
    mesh = converted(tmp_path, source, "--only", "soft", "--fix-orientation")
    assert measures.faulty_elements(mesh) == [] and content(mesh) == pytest.approx(2)
    assert "turned around: 1 quad4" in capsys.readouterr().out


def test_nodes_at_one_place_are_told_and_merged(tmp_path, capsys):
    source = tmp_path / "x.inp"
    source.write_text(ABAQUS.replace("31, 2., 1.", "31, 2., 1.\n40, 1., 0.\n41, 1., 1.0000001").replace("5, 20, 30, 31, 21", "5, 40, 30, 31, 41"))
    parted = converted(tmp_path, source, "--only", "soft")
    assert "note: 1 nodes lie at the place of another one" in capsys.readouterr().out
    joined = converted(tmp_path, source, "--only", "soft", "--merge", "1e-5")
    assert "joined with another node: 2" in capsys.readouterr().out
    assert [len(mf.boundary_sides(mesh)) for mesh in (parted, joined)] == [8, 6] and len(joined.nodes) == 6


@pytest.mark.parametrize("cells, message", [
    ([("wedge", [[0, 1, 2, 3, 4, 5]]), ("tetra", [[0, 1, 2, 3]])], "1 wedge, which gimp.x does not have; it has: tetrahedron4 hexahedron8. Mesh with"),
    ([("pyramid", [[0, 1, 2, 3, 4]]*2)], "2 pyramid"),
    ([("tetra10", [list(range(10))])], "1 tetra10, which gimp.x does not have; it has: tetrahedron4 hexahedron8. Take the corners alone with --linear"),
    ([("hexahedron20", [list(range(20))])], "1 hexahedron20"),
    ([("vertex", [[0]])], "has no elements"),
])
def test_elements_that_gimp_does_not_have(cells, message, tmp_path):
    meshio = pytest.importorskip("meshio")
    points = np.random.RandomState(1).random_sample((20, 3))
    meshio.Mesh(points, [(kind, np.array(table)) for kind, table in cells]).write(tmp_path / "x.vtu")
    assert message in refused(convert_mesh.main, tmp_path / "x.vtu", tmp_path / "o.h5")


@pytest.mark.parametrize("kind, linear", [("triangle6", "triangle3"), ("quad8", "quad4"), ("quad9", "quad4"), ("tetra10", "tetrahedron4"),
                                          ("hexahedron20", "hexahedron8")])
def test_corners_alone(kind, linear, tmp_path, capsys):
    meshio = pytest.importorskip("meshio")
    corners = measures.natural_nodes(linear)
    count = {"triangle6": 6, "quad8": 8, "quad9": 9, "tetra10": 10, "hexahedron20": 20}[kind]
    if kind in measures.SPACES:
        points = measures.natural_nodes(kind)
    else:
        points = np.concatenate([corners, np.random.RandomState(1).random_sample((count - len(corners), 3))])
    points = np.hstack([points, np.zeros((count, 3 - points.shape[1]))])
    meshio.Mesh(points, [(kind, np.arange(count)[None])]).write(tmp_path / "x.vtu")
    mesh = converted(tmp_path, tmp_path / "x.vtu", "--linear")
    assert list(mesh.elements) == [linear] and (mesh.nodes == corners).all()
    assert f"left out: {count - len(corners)} nodes that no element has" in capsys.readouterr().out
    if kind in ("triangle6", "quad8"):
        converted(tmp_path, tmp_path / "x.vtu")
        assert f"note: {kind} are for bodies" in capsys.readouterr().out


def test_other_planes(tmp_path):
    meshio = pytest.importorskip("meshio")
    meshio.Mesh([(0, 7.0, 0), (1, 7.0, 0), (0, 7.0, 2)], [("triangle", np.array([[0, 1, 2]]))]).write(tmp_path / "x.vtu")
    assert "z from 0 to 2" in refused(convert_mesh.main, tmp_path / "x.vtu", tmp_path / "o.h5")
    assert converted(tmp_path, tmp_path / "x.vtu", "--plane", "xz").nodes.tolist() == [[0, 0], [1, 0], [0, 2]]


@pytest.mark.parametrize("name, text, message", [("x.msh", "no mesh", "cannot be read as a mesh"), ("x.abc", "no mesh", "Could not deduce"),
                                                 ("x.inp", "*NODE\n1, 0, x\n", "line 2: a node has"), ("x.inp", "no mesh", "has no elements")])
def test_files_that_are_no_meshes(name, text, message, tmp_path):
    if not name.endswith(".inp"):
        pytest.importorskip("meshio")
    (tmp_path / name).write_text(text)
    assert message in refused(convert_mesh.main, tmp_path / name, tmp_path / "o.h5")
    assert "no such file" in refused(convert_mesh.main, tmp_path / "other.msh", tmp_path / "o.h5")


@pytest.mark.parametrize("surface, message", [
    ("1 0 0 0 1 1 0 0 4 1 7 5 6", "others have none, which meshio cannot read; save without Mesh.SaveAll"),
    ("1 0 0 0 1 1 0 2 1 2 4 1 7 5 6", "14 triangle3 elements are in the groups soil and air"),
])
def test_physical_groups_that_cannot_be_used(surface, message, tmp_path):
    pytest.importorskip("meshio")
    text = (REPOSITORY / "tests" / "data" / "meshes" / "gmsh_41.msh").read_text()
    assert "1 0 0 0 1 1 0 1 1 4 1 7 5 6" in text
    (tmp_path / "x.msh").write_text(text.replace("1 0 0 0 1 1 0 1 1 4 1 7 5 6", surface))
    assert message in refused(convert_mesh.main, tmp_path / "x.msh", tmp_path / "o.h5")


# ------------------------------------------------------------------------------------------- bodies


def filled(tmp_path, source, *words):
    """The datasets of the particle file that fill_body.py writes"""
    path = tmp_path / "particles.h5"
    assert fill_body.main([str(source), str(path), "--density", "2000", *words]) == 0
    with h5py.File(path) as file:
        table = {name: data[:] for name, data in file.items()}
    np.testing.assert_allclose(table["mass"], 2000*table["volume"], rtol=1e-15)
    return table


def corners_of(table):
    """(n, corners, dim)"""
    return table["corner"].reshape(len(table["corner"]), -1, table["position"].shape[1])


KIND_OF_CORNERS = {(1, 2): "line2", (2, 3): "triangle3", (2, 4): "quad4", (3, 4): "tetrahedron4", (3, 8): "hexahedron8"}


@pytest.mark.parametrize("words, more, particles", [
    (["block", "--type", "line2", "--cells", "5", "--ratio", "2"], ["--per-element", "3"], 15),
    (["block", "--cells", "4,3", "--distort", "0.3"], [], 48),
    (["block", "--cells", "4,3", "--distort", "0.3"], ["--simplices", "--per-element", "1"], 24),
    (["block", "--type", "triangle3", "--cells", "4,3", "--distort", "0.3"], ["--per-element", "3"], 216),
    (["block", "--type", "triangle6", "--cells", "4,3", "--distort", "0.3"], [], 96),
    (["block", "--type", "quad8", "--cells", "4,3", "--distort", "0.3"], [], 48),
    (["block", "--type", "hexahedron8", "--cells", "2,2,3"], [], 96),
    (["block", "--type", "hexahedron8", "--cells", "2,2,3", "--distort", "0.3"], [], 96),
    (["block", "--type", "hexahedron8", "--cells", "2,2,3"], ["--simplices"], 576),
    (["tet_block", "--cells", "2,2,2", "--distort", "0.3"], ["--per-element", "3"], 40*27),
    (["hybrid", "--cells", "4,2"], ["--simplices"], 4*4*2 + 8*4),
])
def test_parts_of_elements_fill_them(words, more, particles, tmp_path):
    """Contents add up to that of the mesh, also with the centroids as weights; corners are shared to the last bit"""
    mesh = made(tmp_path, *words)
    table = filled(tmp_path, tmp_path / "made.h5", *more)
    assert len(table["mass"]) == particles
    assert table["volume"].sum() == pytest.approx(1, rel=1e-12) and (table["volume"] > 0).all()
    np.testing.assert_allclose(table["volume"] @ table["position"], 0.5, rtol=1e-12)  # a unit cube
    np.testing.assert_allclose(np.prod(2*table["half_length"], axis=1), table["volume"], rtol=1e-12)
    corners = corners_of(table)
    kind = KIND_OF_CORNERS[mesh.dim, corners.shape[1]]
    np.testing.assert_allclose(measures.volumes(kind, corners), table["volume"], rtol=1e-12)  # all sides are straight here
    places, which = np.unique(corners.reshape(-1, mesh.dim), axis=0, return_inverse=True)
    assert len(places) == len(np.unique(np.round(places, 9), axis=0))
    particle_mesh = mf.Mesh(places, {kind: which.reshape(corners.shape[:2])})
    if "--simplices" not in more:
        assert length_of_boundary(particle_mesh) == pytest.approx({1: 2, 2: 4, 3: 6}[mesh.dim], rel=1e-12)  # no gaps inside


def length_of_boundary(mesh):
    sides = mf.boundary_sides(mesh)
    return len(sides) if mesh.dim == 1 else length_of_sides(mesh, sides).sum()


def test_parts_of_a_cartesian_block_are_its_cells(tmp_path):
    made(tmp_path, "block", "--upper", "2,1", "--cells", "4,5")
    table = filled(tmp_path, tmp_path / "made.h5")
    np.testing.assert_allclose(table["half_length"], [[0.125, 0.05]]*80, rtol=1e-14)
    assert len(np.unique(np.round(table["position"], 12), axis=0)) == 80
    np.testing.assert_allclose(corners_of(table)[:, 0], table["position"] - table["half_length"], atol=1e-15)
    np.testing.assert_allclose(corners_of(table)[:, 2], table["position"] + table["half_length"], atol=1e-15)


def test_curved_elements_count_with_their_area(tmp_path):
    made(tmp_path, "ring", "--type", "quad9", "--radii", "1,2", "--cells", "2,6")
    table = filled(tmp_path, tmp_path / "made.h5")
    # sides follow the circle to the fourth power of their angle
    assert table["volume"].sum() == pytest.approx(0.75*math.pi, rel=1e-4)
    radius = table["volume"] @ np.linalg.norm(table["position"], axis=1)/table["volume"].sum()
    assert radius == pytest.approx(14/9, rel=5e-3)  # mean radius of an annulus; centroids lie a little inside


def test_groups_are_filled(tmp_path):
    made(tmp_path, "slope")
    table = filled(tmp_path, tmp_path / "made.h5", "--group", "soil", "--velocity", "-1,0.5")
    assert table["volume"].sum() == pytest.approx(68, rel=1e-12) and len(table["mass"]) == 4*320
    assert (table["velocity"] == [-1, 0.5]).all()
    x, y = table["position"].T
    assert (y < np.clip(11 - x, 2, 6)).all()
    both = filled(tmp_path, tmp_path / "made.h5", "--group", "soil", "--group", "air", "--per-element", "1")
    assert both["volume"].sum() == pytest.approx(150, rel=1e-12) and "velocity" not in both


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", ["triangle3", "tetrahedron4"])
def test_cut_simplices_are_equal_and_whole(kind, count):
    parts = element_parts.natural_parts(kind, count)
    dim = parts.shape[2]
    assert len(parts) == count**dim
    np.testing.assert_allclose(measures.volumes(kind, parts), 1/math.factorial(dim)/count**dim, rtol=1e-12)
    assert (parts >= 0).all() and (parts.sum(2) <= 1 + 1e-15).all()


def write_stl(path, triangles):
    """An STL file in plain text"""
    lines = ["solid made"]
    for corners in triangles:
        lines += [" facet normal 0 0 0", "  outer loop", *("   vertex {:.9g} {:.9g} {:.9g}".format(*x) for x in corners), "  endloop", " endfacet"]
    path.write_text("\n".join([*lines, "endsolid made", ""]))
    return path


def cube_triangles(lower, upper):
    """Twelve triangles around a box, seen from outside counter-clockwise"""
    corner = np.where((measures.natural_nodes("hexahedron8") > 0), upper, lower)
    return np.concatenate([corner[[[a, b, c], [a, c, d]]] for a, b, c, d in mf.HEXAHEDRON_FACES])


def sphere_triangles(radius, rounds=4):
    """An octahedron whose triangles are cut into four, `rounds` times, and blown up"""
    x, y, z = np.eye(3)
    found = np.array([(a, b, c) if s > 0 else (a, c, b) for sx in (1, -1) for sy in (1, -1) for sz in (1, -1)
                      for a, b, c, s in [(sx*x, sy*y, sz*z, sx*sy*sz)]])
    for _ in range(rounds):
        a, b, c = found.transpose(1, 0, 2)
        ab, bc, ca = ((p + q)/np.linalg.norm(p + q, axis=1)[:, None] for p, q in ((a, b), (b, c), (c, a)))
        found = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    return radius*found


def test_inside_of_a_box(tmp_path, capsys):
    pytest.importorskip("meshio")
    source = write_stl(tmp_path / "box.stl", cube_triangles(np.array([0.0, 0.1, -0.2]), np.array([0.5, 0.4, 0.2])))
    table = filled(tmp_path, source, "--spacing", "0.05")
    assert len(table["mass"]) == 10*6*8 and table["volume"].sum() == pytest.approx(0.06, rel=1e-12)
    assert (table["half_length"] == 0.025).all()
    corners = corners_of(table)
    np.testing.assert_allclose(corners.min((0, 1)), [0, 0.1, -0.2], atol=1e-12)
    np.testing.assert_allclose(corners.max((0, 1)), [0.5, 0.4, 0.2], atol=1e-12)
    np.testing.assert_allclose(measures.volumes("hexahedron8", corners), 0.05**3, rtol=1e-12)
    assert "12 triangles around 0.06 m3" in capsys.readouterr().out
    large = filled(tmp_path, source, "--spacing", "50", "--scale", "1000")
    np.testing.assert_allclose(large["position"], 1000*table["position"], atol=1e-9)


def test_inside_of_a_sphere(tmp_path):
    """Columns go through corners and edges of the octahedron, and still each point is asked for once"""
    pytest.importorskip("meshio")
    source = write_stl(tmp_path / "ball.stl", sphere_triangles(1.0))
    table = filled(tmp_path, source, "--spacing", "0.1")
    # 4.19 m3: within 1 % with the chance of a lattice; triangles lie inside the ball by 0.6 % of its volume
    assert table["volume"].sum() == pytest.approx(4/3*math.pi, rel=0.01)
    distance = np.linalg.norm(table["position"], axis=1)
    assert distance.max() < 1
    i, j, k = np.meshgrid(*[np.arange(-10, 10)]*3, indexing="ij")
    sure = (np.stack([i, j, k], -1).reshape(-1, 3) + 0.5)*0.1
    assert len(distance) >= (np.linalg.norm(sure, axis=1) < 0.99).sum()


def test_a_hole_is_left_empty(tmp_path):
    pytest.importorskip("meshio")
    inner = cube_triangles(np.full(3, 0.25), np.full(3, 0.75))[:, ::-1]  # looks into the hole
    source = write_stl(tmp_path / "hollow.stl", np.concatenate([cube_triangles(np.zeros(3), np.ones(3)), inner]))
    table = filled(tmp_path, source, "--spacing", "0.125")
    assert table["volume"].sum() == pytest.approx(1 - 0.125, rel=1e-12)
    assert not (np.abs(table["position"] - 0.5).max(1) < 0.25).any()


def test_points_in_line_with_edges_and_corners():
    """A lattice whose columns run through the edges of a tilted octahedron's triangles counts what exact geometry says"""
    x, y, z = 4*np.eye(3)
    octahedron = np.array([(a, b, c) if s > 0 else (a, c, b) for sx in (1, -1) for sy in (1, -1) for sz in (1, -1)
                           for a, b, c, s in [(sx*x, sy*y, sz*z, sx*sy*sz)]])
    inside = fill_body.lattice_inside(octahedron, np.array([-4.0, -4.0, -3.5]), 1.0, (9, 9, 8))
    i, j, k = np.meshgrid(np.arange(-4, 5), np.arange(-4, 5), np.arange(-4, 4) + 0.5, indexing="ij")
    assert (inside == (np.abs(i) + np.abs(j) + np.abs(k) < 4)).all()  # none lies on the surface: sums end in 0.5


@pytest.mark.parametrize("change, words, message", [
    (lambda t: t[1:], ["--spacing", "0.1"], "not closed: 3 of 18 edges"),
    (lambda t: np.concatenate([t[:1, ::-1], t[1:]]), ["--spacing", "0.1"], "not closed"),
    (lambda t: t, [], "--spacing"),
    (lambda t: t, ["--spacing", "3"], "no middle of a cube"),
    (lambda t: t, ["--spacing", "1e-5"], "take a larger one"),
    (lambda t: t, ["--spacing", "0.1", "--group", "soil"], "--group is for a mesh file"),
    (lambda t: t, ["--spacing", "0.1", "--per-element", "2"], "--per-element is for a mesh file"),
    (lambda t: t, ["--spacing", "0.1", "--velocity", "1,2"], "2 numbers for a body in 3D"),
])
def test_surface_is_refused(change, words, message, tmp_path):
    pytest.importorskip("meshio")
    source = write_stl(tmp_path / "box.stl", change(cube_triangles(np.zeros(3), np.ones(3))))
    assert message in refused(fill_body.main, source, tmp_path / "o.h5", "--density", "1", *words)
    assert not (tmp_path / "o.h5").exists()


@pytest.mark.parametrize("words, message", [
    (["--group", "mud"], "no such group; it has: quads triangles"),
    ([], "triangle3 and quad4"),
    (["--spacing", "0.1"], "--spacing is for a surface"),
    (["--per-element", "0"], "usage"),
    (["--density", "-1"], "usage"),
    (["--simplices", "--velocity", "1"], "1 numbers for a body in 2D"),
])
def test_filling_a_mesh_is_refused(words, message, tmp_path):
    made(tmp_path, "hybrid", "--cells", "4,2")
    assert message in refused(fill_body.main, tmp_path / "made.h5", tmp_path / "o.h5", "--density", "1", *words)
    assert not (tmp_path / "o.h5").exists()


@pytest.mark.parametrize("path", MESHES, ids=lambda path: path.stem)
def test_gimp_reads_the_meshes_of_scenes(path, run_scene, tmp_path):
    """Bodies of the first group (or of all elements), filled by gimp.x and by fill_body.py, have the same volume"""
    mesh = mf.read_mesh(path)
    group = f'group = "{mesh.element_groups[0]}"' if mesh.element_groups else ""
    scene = f"""&scene dimension = {mesh.dim} /
&mesh file = "{path}" /
&material name = "rubber" model = "neo_hookean" density = 2000.0 young_modulus = 1.0e6 poisson_ratio = 0.3 /
&body name = "body" material = "rubber" shape = "elements" {group} /
&boundary side = "{mesh.side_groups[0]}" condition = "slip" /
&method basis = "linear" /
&time end = 1.0 max_steps = 2 /
&output name = "x" fields = "volume" precision = "double" /
"""
    run = run_scene(scene, tmp_path).succeeded()
    filled(tmp_path, path, *(["--group", mesh.element_groups[0]] if group else []))
    with h5py.File(tmp_path / "particles.h5") as file:
        volume = file["volume"][:].sum()
    assert run.last_frame["volume"].sum() == pytest.approx(volume, rel=1e-12)


@pytest.mark.parametrize("words, domain", [(["disk", "--radius", "0.3", "--rings", "4", "--center", "0.5,0.5"], "simplex"),
                                           (["ring", "--radii", "0.3,0.5", "--cells", "3,9"], "box")])
def test_gimp_runs_with_such_bodies(words, domain, run_scene, tmp_path):
    """A body in flight stays as it is: its corners are those of its particles"""
    made(tmp_path, *words)
    table = filled(tmp_path, tmp_path / "made.h5", "--velocity", "0.5,0.5")
    scene = """&scene dimension = 2 /
&grid lower = -0.25, -0.25 upper = 1.25, 1.25 spacing = 0.05 /
&material name = "rubber" model = "neo_hookean" density = 2000.0 young_modulus = 1.0e6 poisson_ratio = 0.3 /
&body name = "body" material = "rubber" shape = "file" file = "particles.h5" /
&method basis = "cpdi2" particle_domain = "{}" /
&time end = 0.1 max_steps = 20 /
&output name = "x" fields = "velocity", "volume" precision = "double" /
""".format(domain)
    run = run_scene(scene, tmp_path).succeeded()
    assert run.summary["particles"] == len(table["mass"]) and run.summary["steps"] == 20
    np.testing.assert_allclose(run.last_frame["velocity"][:, :2], 0.5, atol=1e-9)  # round-off of corners, times the stiffness
    assert run.last_frame["volume"].sum() == pytest.approx(table["volume"].sum(), rel=1e-9)

"""Bad mesh files are refused by the whole program, with the words that name elements and say what to do (all of them: the unit tests
mesh.test_mesh_checks and mesh.test_mesh_file); the example of docs/mesh-format.md is sound."""
import re

import pytest

from conftest import REPOSITORY

h5py = pytest.importorskip("h5py")
np = pytest.importorskip("numpy")

SCENE = """&scene dimension = {dimension} /
&mesh file = "bad.h5" /
&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e4 poisson_ratio = 0.3 /
&body name = "all" material = "rubber" shape = "elements" /
&time end = 1.0 /
&method basis = "linear" /
"""


class Mesh:
    """Squares n x m of edge 1/4, numbered along x first, with the sides at the lowest x named left"""

    def __init__(self, n=3, m=2):
        x, y = np.meshgrid(np.arange(n + 1), np.arange(m + 1))
        self.nodes = 0.25*np.column_stack([x.ravel(), y.ravel()])
        corner = np.array([1 + i + (n + 1)*j for j in range(m) for i in range(n)])
        self.elements = {"quad4": np.column_stack([corner, corner + 1, corner + n + 2, corner + n + 1])}
        start = 1 + (n + 1)*np.arange(m)
        self.sides = np.column_stack([start, start + n + 1, 0*start, 0*start])
        self.group = np.ones(m, int)
        self.side_groups = "left"

    def write(self, path):
        with h5py.File(path, "w") as file:
            file.attrs["format"], file.attrs["version"], file.attrs["dimension"] = "gimp-mesh", 1, self.nodes.shape[1]
            file.attrs["side_groups"] = self.side_groups
            file["nodes"], file["sides/nodes"], file["sides/group"] = self.nodes, self.sides, self.group
            for kind, table in self.elements.items():
                file[f"elements/{kind}"] = table


def missing_node(mesh):
    mesh.elements["quad4"][4, 2] = 13
    return ["elements with nodes that are not there: quad4 element 5; nodes are numbered from 1 to 12"]


def not_a_number(mesh):
    mesh.nodes[6, 1] = np.nan
    return ["coordinates that are not finite numbers: node 7; correct or remove these nodes"]


def duplicate(mesh):
    mesh.elements["quad4"] = np.vstack([mesh.elements["quad4"], mesh.elements["quad4"][2, [1, 2, 3, 0]]])
    return ["elements that are there twice: quad4 element 7 (as quad4 element 3); remove one of each"]


def negative_volume(mesh):
    mesh.elements["quad4"] = mesh.elements["quad4"][:, ::-1]
    return ["inverted elements (negative volume): quad4 element 1, quad4 element 2, quad4 element 3, quad4 element 4, quad4 element 5 and 1 "
            "more; reverse the order of their nodes"]


def bad_shape(mesh):
    mesh.nodes[5] += 0.15
    return ["badly shaped elements (smallest Jacobian over its mean): quad4 element 5 ("]


def hanging_node(mesh):
    """The last square gives way to two halves"""
    mesh.nodes = np.vstack([mesh.nodes, [[0.5, 0.375], [0.75, 0.375]]])
    mesh.elements["quad4"] = np.vstack([mesh.elements["quad4"][:5], [[7, 8, 14, 13], [13, 14, 12, 11]]])
    return ["hanging nodes (on a side of an element that does not have them): node 13 on quad4 element 5; split that element"]


def not_merged(mesh):
    mesh.nodes = np.vstack([mesh.nodes, mesh.nodes[[1, 5, 9]]])
    mesh.elements["quad4"][[0, 3]] = [[1, 13, 14, 5], [5, 14, 15, 9]]
    return ["different nodes at the same place: node 2 and node 13, node 6 and node 14, node 10 and node 15; merge them"]


def mixed_dimensions(mesh):
    mesh.elements["line2"] = np.array([[1, 2], [2, 3]])
    return ["elements/line2 in a mesh of dimension 2: all elements have its dimension"]


def unused_nodes(mesh):
    mesh.nodes = np.vstack([mesh.nodes, [[0.1, 0.1]]])
    return ["nodes that no element has: node 13; remove them"]


def side_inside(mesh):
    mesh.sides[1, :2] = [2, 6]
    return ["named sides inside of the mesh: 'left' at node 2 node 6 between quad4 element 1 and quad4 element 2"]


def several(mesh):
    mesh.elements["quad4"][2] = mesh.elements["quad4"][2, ::-1]
    mesh.nodes = np.vstack([mesh.nodes, [[0.1, 0.1]]])
    mesh.elements["quad4"][0, 1] = 1
    return ["elements with the same node twice: quad4 element 1", "nodes that no element has: node 13",
            "inverted elements (negative volume): quad4 element 3"]


CASES = [missing_node, not_a_number, duplicate, negative_volume, bad_shape, hanging_node, not_merged, mixed_dimensions, unused_nodes,
         side_inside, several]


def check_refusal(run, wanted):
    assert run.code == 2, run.stderr
    messages = [line for line in run.stderr.splitlines() if line.startswith("  line ")]  # mpirun has words of its own
    assert len(messages) == len(wanted), run.stderr
    for line, part in zip(messages, wanted):
        assert line.startswith(f'  line 2: &mesh: file = "bad.h5"; {part}'), line


@pytest.mark.parametrize("spoil", CASES, ids=lambda spoil: spoil.__name__)
def test_is_refused(run_scene, tmp_path, spoil):
    mesh = Mesh()
    wanted = spoil(mesh)
    mesh.write(tmp_path / "bad.h5")
    check_refusal(run_scene(SCENE.format(dimension=2), tmp_path, arguments=("--check",)), wanted)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.h5"]


def test_ranks_tell_the_same(run_ranks, tmp_path):
    mesh = Mesh()
    wanted = several(mesh)
    mesh.write(tmp_path / "bad.h5")
    check_refusal(run_ranks(SCENE.format(dimension=2), tmp_path, 2), wanted)


def test_example_of_the_page(run_scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(re.search(r"```python\n(.*?)```", (REPOSITORY / "docs" / "mesh-format.md").read_text(), re.DOTALL).group(1), {})
    text = SCENE.format(dimension=2).replace("bad.h5", "square.h5")
    run_scene(text + '&boundary side = "floor" condition = "stick" /', tmp_path, arguments=("--check",)).succeeded()

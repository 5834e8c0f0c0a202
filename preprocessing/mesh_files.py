"""The mesh file of gimp.x: what a mesh is here, writing and reading it, who shares which side.

    mesh = read_mesh("slope.h5")        a Mesh: nodes, elements by kind, named groups of elements and of boundary sides
    write_mesh("slope.h5", mesh)        the same bytes each time

In memory nodes are numbered from 0; the file numbers them from 1 (docs/mesh-format.md). The nodes of an element stand in the
order of VTK: corners first (in 2D counter-clockwise), then middles of sides, then the centre.
Needs numpy and h5py. A `MeshError` is a mistake of the user or of a file, in one line.
"""
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

FORMAT, VERSION = "gimp-mesh", 1
LONGEST_NAME = 32  # characters


class MeshError(Exception):
    """A mistake that a line or two can explain"""


@dataclass(frozen=True)
class Kind:
    """A kind of element"""
    dim: int
    nodes: int
    corners: int
    sides: tuple  # corners of each side, as places in its list of nodes; seen from outside counter-clockwise
    turned: tuple  # the order of its nodes that turns it inside out


POINTS = ((0,), (1,))
TRIANGLE_EDGES = ((0, 1), (1, 2), (2, 0))
QUAD_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0))
TETRAHEDRON_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
HEXAHEDRON_FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))

KINDS = {
    "line2": Kind(1, 2, 2, POINTS, (1, 0)),
    "triangle3": Kind(2, 3, 3, TRIANGLE_EDGES, (0, 2, 1)),
    "triangle6": Kind(2, 6, 3, TRIANGLE_EDGES, (0, 2, 1, 5, 4, 3)),
    "quad4": Kind(2, 4, 4, QUAD_EDGES, (0, 3, 2, 1)),
    "quad8": Kind(2, 8, 4, QUAD_EDGES, (0, 3, 2, 1, 7, 6, 5, 4)),
    "quad9": Kind(2, 9, 4, QUAD_EDGES, (0, 3, 2, 1, 7, 6, 5, 4, 8)),
    "tetrahedron4": Kind(3, 4, 4, TETRAHEDRON_FACES, (0, 2, 1, 3)),
    "hexahedron8": Kind(3, 8, 8, HEXAHEDRON_FACES, (0, 3, 2, 1, 4, 7, 6, 5)),
}


@dataclass
class Mesh:
    """Nodes, elements by kind, and the names given to some of them"""
    nodes: np.ndarray  # (n, dim) [m]
    elements: dict  # kind -> (n, nodes of the kind) node numbers from 0
    element_groups: list = field(default_factory=list)  # names
    groups: dict = field(default_factory=dict)  # kind -> (n,) 0: in no group, k: in the k-th of element_groups
    side_groups: list = field(default_factory=list)  # names
    sides: np.ndarray = None  # (n, 4) corners of the sides that have a name, -1 where a side has fewer
    side_group: np.ndarray = None  # (n,) k: the k-th of side_groups

    def __post_init__(self):
        self.nodes = np.asarray(self.nodes, float).reshape(len(self.nodes), -1)
        self.elements = {kind: np.asarray(self.elements[kind], np.int64) for kind in KINDS
                         if kind in self.elements and len(self.elements[kind])}
        self.groups = {kind: np.asarray(self.groups.get(kind, np.zeros(len(table))), np.int64) for kind, table in self.elements.items()}
        self.sides = np.zeros((0, 4), np.int64) if self.sides is None else np.asarray(self.sides, np.int64)
        self.side_group = np.zeros(0, np.int64) if self.side_group is None else np.asarray(self.side_group, np.int64)

    @property
    def dim(self):
        return self.nodes.shape[1]

    def count(self):
        """Number of elements of all kinds"""
        return sum(map(len, self.elements.values()))


# ------------------------------------------------------------------------------------------------ files


def write_mesh(path, mesh, made_by=""):
    """Write a mesh file, or say why not; the same bytes for the same mesh. `made_by`: the command that made it, for whoever finds the file"""
    check_names(mesh.element_groups, "element group")
    check_names(mesh.side_groups, "side")
    try:
        file = h5py.File(path, "w", libver=("earliest", "v108"))
    except OSError as problem:
        raise MeshError(f"{path}: cannot be written ({problem})") from None
    with file:
        file.attrs["format"] = np.bytes_(FORMAT)  # of fixed length, as all texts here
        file.attrs["version"] = np.int32(VERSION)
        file.attrs["dimension"] = np.int32(mesh.dim)
        if made_by:
            file.attrs["made_by"] = np.bytes_(made_by)
        put(file, "nodes", mesh.nodes, np.float64)
        for kind, table in mesh.elements.items():
            put(file, f"elements/{kind}", table + 1, np.int32)
            if mesh.element_groups:
                put(file, f"elements/{kind}_group", mesh.groups[kind], np.int32)
        if mesh.element_groups:
            file.attrs["element_groups"] = np.bytes_("\n".join(mesh.element_groups))
        if mesh.side_groups:
            file.attrs["side_groups"] = np.bytes_("\n".join(mesh.side_groups))
            put(file, "sides/nodes", mesh.sides + 1, np.int32)
            put(file, "sides/group", mesh.side_group, np.int32)


def put(file, name, values, kind):
    """A dataset that does not tell when it was written"""
    file.create_dataset(name, data=np.ascontiguousarray(values, kind), track_times=False)


def check_names(names, what):
    """Names must suit a scene: they are compared word by word there"""
    for name in names:
        if not name.isascii() or not name.isprintable() or not name.strip() or len(name) > LONGEST_NAME:
            raise MeshError(f"{what} '{name}': a name has 1 to {LONGEST_NAME} printable ASCII characters; rename it where the mesh is made")
    for name in sorted(set(names)):
        if names.count(name) > 1:
            raise MeshError(f"{what} '{name}' is there {names.count(name)} times; a name may be given once")


def read_mesh(path):
    """The mesh of a file; checked as far as other scripts need it: shapes, numbers of nodes and of groups"""
    if not Path(path).exists():
        raise MeshError(f"{path}: no such file")
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise MeshError(f"{path}: is not an HDF5 file; convert_mesh.py makes one of meshes in other formats") from None
    with file:
        if text_of(file.attrs.get("format", "")) != FORMAT:
            raise MeshError(f"{path}: is not a mesh file (its attribute format is not '{FORMAT}')")
        if int(file.attrs.get("version", 0)) != VERSION:
            raise MeshError(f"{path}: has version {file.attrs.get('version')} of the format; this script reads version {VERSION}")
        try:
            nodes = file["nodes"][:]
            found = file["elements"]
            unknown = [name for name in found if name.removesuffix("_group") not in KINDS]
            if unknown:
                raise MeshError(f"{path}: elements/{unknown[0]} is not a kind of element; there are: {' '.join(KINDS)}")
            mesh = Mesh(nodes, {kind: found[kind][:] - 1 for kind in KINDS if kind in found},
                        names_of(file, "element_groups"),
                        {kind: found[kind + "_group"][:] for kind in KINDS if kind + "_group" in found},
                        names_of(file, "side_groups"))
            if "sides" in file:
                mesh.sides, mesh.side_group = file["sides/nodes"][:].astype(np.int64) - 1, file["sides/group"][:].astype(np.int64)
        except (KeyError, ValueError) as problem:
            raise MeshError(f"{path}: is not a complete mesh file ({problem})") from None
    check_mesh(path, mesh)
    return mesh


def text_of(value):
    return value.decode("utf-8", "replace").rstrip("\0 ") if isinstance(value, bytes) else str(value)


def names_of(file, name):
    text = text_of(file.attrs.get(name, ""))
    return text.split("\n") if text else []


def check_mesh(path, mesh):
    """Tables of the right shapes with numbers in range"""
    if not mesh.elements:
        raise MeshError(f"{path}: has no elements")
    for kind, table in mesh.elements.items():
        if table.ndim != 2 or table.shape[1] != KINDS[kind].nodes:
            raise MeshError(f"{path}: elements/{kind} has shape {table.shape}; must be (n, {KINDS[kind].nodes})")
        if KINDS[kind].dim != mesh.dim:
            raise MeshError(f"{path}: {kind} has no place among nodes of {mesh.dim} coordinates")
        bad = np.flatnonzero(((table < 0) | (table >= len(mesh.nodes))).any(1))
        if len(bad):
            raise MeshError(f"{path}: {kind} element {bad[0] + 1} names a node that is not among 1 .. {len(mesh.nodes)}")
        if len(mesh.groups[kind]) != len(table):
            raise MeshError(f"{path}: elements/{kind}_group has {len(mesh.groups[kind])} numbers for {len(table)} elements")
        if mesh.groups[kind].min() < 0 or mesh.groups[kind].max() > len(mesh.element_groups):
            raise MeshError(f"{path}: elements/{kind}_group has numbers beyond the {len(mesh.element_groups)} names of element_groups")


# ------------------------------------------------------------------------------------------------ sides


def all_sides(mesh):
    """Sides of all elements: corners (n, 4), -1 beyond those of a side; kind by number in KINDS, element, side, each (n,)"""
    corners, kinds, elements, numbers = [], [], [], []
    for kind, table in mesh.elements.items():
        sides = KINDS[kind].sides
        block = np.full((len(table), len(sides), 4), -1)
        for s, side in enumerate(sides):
            block[:, s, :len(side)] = table[:, side]
        corners.append(block.reshape(-1, 4))
        kinds.append(np.full(len(table)*len(sides), list(KINDS).index(kind)))
        elements.append(np.repeat(np.arange(len(table)), len(sides)))
        numbers.append(np.tile(np.arange(len(sides)), len(table)))
    return tuple(map(np.concatenate, (corners, kinds, elements, numbers)))


def unique_rows(rows):
    """The different rows of a table of whole numbers, in order: where each is first, which of them each row is, how often each is there

    As np.unique with axis=0, in a tenth of the time: columns are packed into one number as long as it holds them.
    """
    key, most = np.zeros(len(rows), np.int64), 1
    for column in np.asarray(rows, np.int64).T:
        column = column - column.min(initial=0)
        wide = int(column.max(initial=0)) + 1
        if most*wide >= 2**62:
            found, key = np.unique(key, return_inverse=True)
            most = len(found)
        key, most = key*wide + column, most*wide
    _, first, which, counts = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    return first, which, counts


def sharing(corners):
    """How many of these sides have the same corners, in any order: (n,)"""
    _, which, counts = unique_rows(np.sort(corners, axis=1))
    return counts[which]


def boundary_sides(mesh):
    """Corners (n, 4) of the sides that one element has alone; a side of more than two is a mistake in the mesh"""
    corners, kinds, elements, _ = all_sides(mesh)
    shared = sharing(corners)
    if shared.max() > 2:
        k = int(np.argmax(shared))
        side = " ".join(str(n + 1) for n in corners[k] if n >= 0)
        raise MeshError(f"{list(KINDS)[kinds[k]]} element {elements[k] + 1} and {shared[k] - 1} others have the side with nodes {side}; "
                        "at most two may share one: look for elements that are there twice or overlap")
    return corners[shared == 1]


# ------------------------------------------------------------------------------------------------ scripts


def run_main(main):
    """Run a script; a mistake ends it with one line and code 2 instead of a traceback"""
    try:
        sys.exit(main())
    except MeshError as problem:
        print(f"{Path(sys.argv[0]).name}: {problem}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)

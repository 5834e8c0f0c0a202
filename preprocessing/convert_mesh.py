#!/usr/bin/env python3
"""Convert a mesh of another program (Gmsh 2.2 and 4.1, VTK, Abaqus, all that meshio reads) into the mesh file of gimp.x.

  convert_mesh.py slope.msh slope.h5
  convert_mesh.py part.inp part.h5 --scale 0.001 --ignore ALL --node-sets BOTTOM
  convert_mesh.py grid.vtu grid.h5 --groups-from material

Named groups of the highest dimension (Gmsh: physical groups, Abaqus: ELSET) become groups of elements, those of one dimension
less (and SURFACE of Abaqus) named sides; cells of less dimension without a name, and nodes that no element has, are left out.
What was found is printed; what gimp.x cannot use is refused. A 2D mesh lies in a plane (--plane), x and y in this order.
"""
import preprocessing_paths  # noqa: F401 isort: skip (must come first)
import argparse
import math
from itertools import product

import numpy as np

from foreign_meshes import dimension_of, read_foreign
from mesh_files import KINDS, Mesh, MeshError, boundary_sides, run_main, unique_rows, write_mesh
from mesh_measures import faulty_elements, report

KIND_OF = {"line": "line2", "triangle": "triangle3", "triangle6": "triangle6", "quad": "quad4", "quad8": "quad8", "quad9": "quad9",
           "tetra": "tetrahedron4", "hexahedron": "hexahedron8"}
LINEAR = {"line3": "line", "triangle6": "triangle", "quad8": "quad", "quad9": "quad", "tetra10": "tetra", "hexahedron20": "hexahedron",
          "hexahedron27": "hexahedron"}
CORNERS = {"line": 2, "triangle": 3, "quad": 4, "tetra": 4, "hexahedron": 8}
ADVICE = {**dict.fromkeys(LINEAR, "take the corners alone with --linear"),
          "wedge": "mesh with tetrahedra alone or hexahedra alone", "pyramid": "mesh with tetrahedra alone or hexahedra alone"}
PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}
SAME_PLACE = 1e-9  # of the size of the mesh: nodes so near to each other are thought to be one


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", help="mesh file of another program")
    parser.add_argument("output", metavar="OUT.h5", help="mesh file to write")
    parser.add_argument("--scale", type=float, default=1.0, help="metres in a unit of the file: 0.001 if it has millimetres (default: 1)")
    parser.add_argument("--plane", choices=tuple(PLANES), default="xy", help="plane of a 2D mesh (default: xy)")
    parser.add_argument("--fix-orientation", action="store_true", help="turn elements with negative volumes around")
    parser.add_argument("--linear", action="store_true", help="leave the nodes between corners out: triangle6 becomes triangle3, and so on")
    parser.add_argument("--merge", type=float, metavar="DISTANCE", help="join nodes that are nearer than this [m]")
    parser.add_argument("--ignore", action="append", default=[], metavar="NAME", help="leave a named group out; may be repeated")
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="take this named group and no others; may be repeated")
    parser.add_argument("--node-sets", action="append", default=[], metavar="NAME",
                        help="name the boundary sides whose corners are all in this set of nodes; may be repeated")
    parser.add_argument("--groups-from", metavar="NAME", help="data of cells, whole numbers, that say their group (VTK; medit:ref; ..)")
    arguments = parser.parse_args(words)
    for name, value in (("--scale", arguments.scale), ("--merge", arguments.merge)):
        if value is not None and not 0 < value < math.inf:
            parser.error(f"{name}: a positive number")
    return arguments


def first_few(numbers):
    """The first of some numbers (from 0), counted from 1"""
    return " ".join(str(n + 1) for n in numbers[:8]) + (" .." if len(numbers) > 8 else "")


# ------------------------------------------------------------------------------------------------ elements


def elements_of(foreign, path):
    """Kind -> table of the cells of the highest dimension; places of the blocks: block -> (kind, first row)"""
    dim = max((dimension_of(kind) for kind, table in foreign.blocks if len(table)), default=0)
    if dim == 0:
        raise MeshError(f"{path}: has no elements")
    unknown = {}
    for kind, table in foreign.blocks:
        if dimension_of(kind) == dim and kind not in KIND_OF:
            unknown[kind] = unknown.get(kind, 0) + len(table)
    if unknown:
        advice = "; ".join(dict.fromkeys(ADVICE[k] for k in unknown if k in ADVICE))
        raise MeshError(f"{path}: has " + ", ".join(f"{n} {kind}" for kind, n in unknown.items())
                        + f", which gimp.x does not have; it has: {' '.join(k for k in KINDS if KINDS[k].dim == dim)}"
                        + (f". {advice[0].upper()}{advice[1:]}" if advice else ""))
    tables, place = {}, {}
    for b, (kind, table) in enumerate(foreign.blocks):
        if dimension_of(kind) == dim:
            kind = KIND_OF[kind]
            rows = tables.setdefault(kind, [])
            place[b] = (kind, sum(map(len, rows)))
            rows.append(table)
    return dim, {kind: np.concatenate(rows) for kind, rows in tables.items()}, place


def flat_nodes(points, dim, plane, path, used):
    """The coordinates that a mesh of this dimension has"""
    if dim == 3:
        return points
    order = PLANES[plane] if dim == 2 else (0, 1, 2)
    for k in order[dim:]:
        low, high = points[used, k].min(), points[used, k].max()
        if high - low > SAME_PLACE*np.ptp(points[used], axis=0).max():
            other = " (or --plane)" if dim == 2 else ""
            raise MeshError(f"{path}: its elements are {'surfaces' if dim == 2 else 'lines'} in space, {'xyz'[k]} from {low:.6g} to {high:.6g}; "
                            f"{'xyz'[k]} must be the same everywhere{other}. A body inside a closed surface: fill_body.py")
    return points[:, order[:dim]]


def turn_around(mesh, fix):
    """Elements that are inside out, twisted, flat or misshapen: turned around if they may be, refused otherwise; notes of what was done"""
    notes, problems = [], []
    for kind, word, found in faulty_elements(mesh):
        if word == "turned" and fix:
            mesh.elements[kind][found] = mesh.elements[kind][found][:, KINDS[kind].turned]
            notes.append(f"turned around: {len(found)} {kind}")
            continue
        told = {"turned": "have a negative volume (--fix-orientation turns them around)",
                "twisted": "are twisted: a corner or a middle node lies on the wrong side",
                "flat": "have no volume",
                "misshapen": "are needles or nearly twisted: mesh again, finer or smoothed, there"}[word]
        problems.append(f"{len(found)} {kind} elements {told}: {first_few(found)}")
    if problems:
        raise MeshError("; ".join(problems))
    return notes


def first_at(nodes, distance):
    """For each node the first one at its place: nodes nearer than `distance` along each axis are one, those beyond twice of it are not"""
    which = np.arange(len(nodes))
    for shift in product((0.0, 0.5), repeat=nodes.shape[1]):  # one of these lattices has both nodes of a pair in one cell
        key = np.floor(nodes/(2*distance) + shift).astype(np.int64)
        first, back, _ = unique_rows(key)
        which = np.minimum(which, which[first[back]])
    while (which[which] != which).any():
        which = which[which]
    return which


# ------------------------------------------------------------------------------------------------ names


def name_elements(mesh, foreign, place, ignored):
    """Put the named sets of elements into groups"""
    for name, parts in foreign.cell_sets.items():
        parts = [(place[b], rows) for b, rows in parts if b in place]
        if name in ignored or not parts:
            continue
        mesh.element_groups.append(name)
        number = len(mesh.element_groups)
        for (kind, first), rows in parts:
            taken = rows[~np.isin(mesh.groups[kind][first + rows], (0, number))]
            if len(taken):
                other = mesh.element_groups[mesh.groups[kind][first + taken[0]] - 1]
                raise MeshError(f"{len(taken)} {kind} elements are in the groups {other} and {name} (the first: {first + taken[0] + 1}); "
                                "an element may be in one: leave a group out with --ignore, or take some with --only")
            mesh.groups[kind][first + rows] = number


def sides_of_names(foreign, dim, new_node, node_sets, outside):
    """Named sides: name -> list of tuples of corners, in the numbers of the mesh"""
    found = {}
    for name, parts in foreign.cell_sets.items():
        for b, rows in parts:
            kind, table = foreign.blocks[b]
            if dimension_of(kind) == dim - 1:
                corners = {"vertex": 1, **CORNERS}[kind.rstrip("0123456789")]
                found.setdefault(name, []).extend(map(tuple, new_node[table[rows][:, :corners]].tolist()))
    for name, sides in foreign.side_sets.items():
        found.setdefault(name, []).extend(tuple(new_node[list(side)].tolist()) for side in sides)
    for name in node_sets:
        if name not in foreign.node_sets:
            raise MeshError(f"--node-sets {name}: no such set; there are: {' '.join(foreign.node_sets) or 'none'}")
        inside = set(new_node[foreign.node_sets[name]].tolist())
        found.setdefault(name, []).extend(side for side in outside if inside.issuperset(side))
    return found


def name_sides(mesh, named, outside, ignored):
    """Put the named sides into the mesh; notes of those that are not on the boundary"""
    notes, group_of = [], {}
    at = {tuple(sorted(side)): side for side in outside}
    for name, sides in named.items():
        if name in ignored:
            continue
        keys = [key for key in dict.fromkeys(tuple(sorted(side)) for side in sides)]
        on_boundary = [key for key in keys if key in at]
        if len(on_boundary) < len(keys):
            notes.append(f"left out of side {name}: {len(keys) - len(on_boundary)} of {len(keys)}, which lie inside the mesh or on no element")
        if not on_boundary:
            continue
        mesh.side_groups.append(name)
        for key in on_boundary:
            other = group_of.setdefault(key, len(mesh.side_groups))
            if other != len(mesh.side_groups):
                raise MeshError(f"the side with nodes {' '.join(str(n + 1) for n in at[key])} is in {mesh.side_groups[other - 1]} and in {name}; "
                                "a side has one name: leave one out with --ignore")
    chosen = [key for key in at if key in group_of]
    mesh.sides = np.full((len(chosen), 4), -1)
    for row, key in enumerate(chosen):
        mesh.sides[row, :len(key)] = at[key]
    mesh.side_group = np.array([group_of[key] for key in chosen], np.int64)
    return notes


# ------------------------------------------------------------------------------------------------ all of it


def convert(arguments):
    """The mesh, and notes of what was changed or left out"""
    foreign = read_foreign(arguments.input, arguments.groups_from)
    if arguments.linear:
        foreign.blocks = [(kind, table) if kind not in LINEAR else (LINEAR[kind], table[:, :CORNERS[LINEAR[kind]]]) for kind, table in foreign.blocks]
    known = {*foreign.cell_sets, *foreign.side_sets}
    for option, names in (("--ignore", arguments.ignore), ("--only", arguments.only)):
        for name in names:
            if name not in known:
                raise MeshError(f"{option} {name}: no such group; there are: {' '.join(sorted(known)) or 'none'}")
    ignored = {*arguments.ignore, *(known - {*arguments.only} if arguments.only else ())}
    dim, tables, place = elements_of(foreign, arguments.input)
    used = np.unique(np.concatenate([table.ravel() for table in tables.values()]))
    nodes = arguments.scale*flat_nodes(foreign.points, dim, arguments.plane, arguments.input, used)
    if not np.isfinite(nodes[used]).all():
        raise MeshError(f"{arguments.input}: a coordinate is not a finite number")
    notes = []
    size = np.ptp(nodes[used], axis=0).max()
    same = np.arange(len(nodes))
    if arguments.merge:
        same[used] = used[first_at(nodes[used], arguments.merge)]
        notes.append(f"joined with another node: {int((same != np.arange(len(nodes))).sum())}")
    elif (doubles := int((first_at(nodes[used], SAME_PLACE*size) != np.arange(len(used))).sum())):
        notes.append(f"note: {doubles} nodes lie at the place of another one; elements do not hang together there, unless with --merge {SAME_PLACE*size:.1e}")
    used = np.unique(same[used])
    new_node = np.full(len(nodes), -1)
    new_node[used] = np.arange(len(used))
    new_node = new_node[same]
    mesh = Mesh(nodes[used], {kind: new_node[table] for kind, table in tables.items()})
    if len(used) < len(nodes):
        notes.append(f"left out: {len(nodes) - len(used)} nodes" + (" that no element has" if not arguments.merge else ""))
    notes += turn_around(mesh, arguments.fix_orientation)
    name_elements(mesh, foreign, place, ignored)
    outside = [tuple(n for n in side if n >= 0) for side in boundary_sides(mesh).tolist()]
    named = sides_of_names(foreign, dim, new_node, arguments.node_sets, outside)
    notes += name_sides(mesh, named, outside, ignored)
    if (curved := [kind for kind in mesh.elements if kind in ("triangle6", "quad8")]):
        notes.append(f"note: {' and '.join(curved)} are for bodies (fill_body.py); as a background their corners would have no positive mass: --linear")
    left = {}
    in_sets = {(b, row) for parts in foreign.cell_sets.values() for b, rows in parts if dimension_of(foreign.blocks[b][0]) == dim - 1 for row in rows}
    for b, (kind, table) in enumerate(foreign.blocks):
        if dimension_of(kind) < dim:
            left[kind] = left.get(kind, 0) + sum((b, row) not in in_sets for row in range(len(table)))
    if any(left.values()):
        notes.append("left out: " + ", ".join(f"{n} {kind}" for kind, n in left.items() if n) + " without a name")
    others = [name for name in foreign.node_sets if name not in arguments.node_sets]
    if others:
        notes.append(f"left out: sets of nodes {' '.join(others)} (--node-sets NAME names the boundary sides between them)")
    return mesh, notes


def main(words=None):
    arguments = parse_arguments(words)
    mesh, notes = convert(arguments)
    write_mesh(arguments.output, mesh)
    print("\n".join(report(mesh) + notes))
    return 0


if __name__ == "__main__":
    run_main(main)

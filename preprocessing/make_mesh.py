#!/usr/bin/env python3
"""Make a mesh of a simple region, with all its sides named. Lengths in metres, lists with commas between.

  make_mesh.py block --upper 2,1 --cells 40,20 block.h5                       quads; --type triangle3, quad9, line2, hexahedron8, ..
  make_mesh.py block --upper 2,1 --cells 40,20 --ratio 4,1 --distort 0.3 --seed 1 block.h5
  make_mesh.py block --intervals-x 0.1,0.1,0.2,0.4 --intervals-y 0.5,0.5 block.h5
  make_mesh.py ring --radii 1,2 --angles 0,90 --cells 16,24 ring.h5           sides inner, outer, axis_x, axis_y
  make_mesh.py triangles --upper 1,1 --size 0.05 triangles.h5                 nearly equilateral
  make_mesh.py disk --radius 0.2 --rings 6 disk.h5                            side rim; --box 0.5: with a square around it
  make_mesh.py hybrid --upper 2,1 --cells 20,10 hybrid.h5                     quads, and triangles beyond half of x
  make_mesh.py tet_block --upper 1,1,1 --cells 8,8,8 tetrahedra.h5            five tetrahedra in each cell

`make_mesh.py KIND --help` tells the options of a kind. --distort moves inner nodes by up to that share of the shortest edge there.
"""
import preprocessing_paths  # noqa: F401 isort: skip (must come first)
import argparse
import re
import sys

import numpy as np

import mesh_makers as makers
from mesh_files import KINDS, MeshError, run_main, write_mesh
from mesh_measures import faulty_elements, report


def numbers(word):
    """Numbers with commas between"""
    try:
        return [float(w) for w in word.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{word}': numbers with commas between") from None


def counts(word):
    """Whole numbers from 1 with commas between"""
    if not re.fullmatch(r"0*[1-9]\d*(,0*[1-9]\d*)*", word):
        raise argparse.ArgumentTypeError(f"'{word}': whole numbers from 1 with commas between")
    return [int(w) for w in word.split(",")]


def positive(word):
    """A positive number"""
    try:
        value = float(word)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{word}': a positive number")
    return value


def whole(word):
    """A whole number from 1"""
    found = counts(word)
    if len(found) > 1:
        raise argparse.ArgumentTypeError(f"'{word}': one whole number")
    return found[0]


# ------------------------------------------------------------------------------------------------ kinds of meshes


def add_box(parser, cells=True):
    parser.add_argument("--lower", type=numbers, metavar="X,Y", help="lower corner [m] (default: zeros)")
    parser.add_argument("--upper", type=numbers, metavar="X,Y", help="upper corner [m] (default: ones)")
    if cells:
        parser.add_argument("--cells", type=counts, metavar="NX,NY", help="cells along each axis")


def box_of(arguments, dim):
    """Lower and upper corner"""
    lower, upper = arguments.lower or [0.0]*dim, arguments.upper or [1.0]*dim
    for name, values in (("lower", lower), ("upper", upper)):
        if len(values) != dim:
            raise MeshError(f"--{name}: {len(values)} numbers for a mesh in {dim}D")
    if not all(a < b for a, b in zip(lower, upper)):
        raise MeshError("--upper must lie above --lower along each axis")
    return lower, upper


def cells_of(arguments, dim):
    if arguments.cells is None or len(arguments.cells) != dim:
        raise MeshError(f"--cells: {dim} whole numbers with commas between are needed")
    return arguments.cells


def add_block(parser):
    add_box(parser)
    parser.add_argument("--type", choices=tuple(KINDS), default="quad4", help="kind of elements (default: quad4)")
    parser.add_argument("--ratio", type=numbers, metavar="RX,RY", help="size of the last cell over that of the first, for each axis (default: ones)")
    for axis in "xyz":
        parser.add_argument(f"--intervals-{axis}", type=numbers, metavar="H,H,..", help=f"sizes [m] of the cells along {axis}, instead of --cells")


def make_block(arguments, kind=None):
    kind = kind or arguments.type
    dim = KINDS[kind].dim
    given = [getattr(arguments, f"intervals_{axis}", None) for axis in "xyz"]
    if any(given):
        if arguments.cells or arguments.ratio or arguments.upper:
            raise MeshError("--intervals-x, -y, -z say all of the cells; leave --cells, --ratio and --upper out")
        if not all(given[:dim]) or any(given[dim:]):
            raise MeshError(f"{kind}: give the intervals of {dim} ax{'is' if dim == 1 else 'es'}: {', '.join('--intervals-' + a for a in 'xyz'[:dim])}")
        if min(map(min, given[:dim])) <= 0:
            raise MeshError("--intervals: sizes must be positive")
        lower = arguments.lower or [0.0]*dim
        if len(lower) != dim:
            raise MeshError(f"--lower: {len(lower)} numbers for a mesh in {dim}D")
        return makers.block(kind, [a + np.concatenate([[0.0], np.cumsum(h)]) for a, h in zip(lower, given)])
    lower, upper = box_of(arguments, dim)
    ratio = arguments.ratio or [1.0]*dim
    if len(ratio) != dim or min(ratio) <= 0:
        raise MeshError(f"--ratio: {dim} positive numbers with commas between are needed")
    return makers.block(kind, [makers.graded(*all_of) for all_of in zip(lower, upper, cells_of(arguments, dim), ratio)])


def add_ring(parser):
    parser.add_argument("--radii", type=numbers, default=[1.0, 2.0], metavar="R,R", help="inner and outer [m] (default: 1,2)")
    parser.add_argument("--angles", type=numbers, default=[0.0, 90.0], metavar="A,A", help="first and last [degrees] (default: 0,90)")
    parser.add_argument("--cells", type=counts, metavar="NR,NA", help="cells along the radius and around")
    parser.add_argument("--type", choices=makers.QUADS, default="quad4", help="kind of elements (default: quad4)")
    parser.add_argument("--ratio", type=positive, default=1.0, help="size of the outermost cell over that of the innermost, along the radius (default: 1)")


def make_ring(arguments):
    if len(arguments.radii) != 2 or not 0 < arguments.radii[0] < arguments.radii[1]:
        raise MeshError("--radii: two numbers, 0 < inner < outer")
    if len(arguments.angles) != 2 or not 0 < arguments.angles[1] - arguments.angles[0] < 360:
        raise MeshError("--angles: two numbers, the last above the first by less than 360")
    nr, na = cells_of(arguments, 2)
    if arguments.angles[1] - arguments.angles[0] >= 180*na:
        raise MeshError("--cells: too few around")
    return makers.ring(arguments.type, makers.graded(*arguments.radii, nr, arguments.ratio), makers.graded(*arguments.angles, na))


def add_triangles(parser):
    add_box(parser, cells=False)
    parser.add_argument("--size", type=positive, required=True, help="edge of a triangle [m], about")


def make_triangles(arguments):
    return makers.triangle_rows(*box_of(arguments, 2), arguments.size)


def add_disk(parser):
    parser.add_argument("--center", type=numbers, default=[0.0, 0.0], metavar="X,Y", help="[m] (default: 0,0)")
    parser.add_argument("--radius", type=positive, default=1.0, help="[m] (default: 1)")
    parser.add_argument("--rings", type=whole, default=8, help="rings of triangles (default: 8)")
    parser.add_argument("--box", type=positive, help="half the edge [m] of a square around the disk that is meshed too (default: none)")


def make_disk(arguments):
    if len(arguments.center) != 2:
        raise MeshError("--center: two numbers")
    if arguments.box and arguments.box <= arguments.radius:
        raise MeshError("--box must be larger than --radius")
    return makers.disk(arguments.center, arguments.radius, arguments.rings, arguments.box)


def add_hybrid(parser):
    add_box(parser)
    parser.add_argument("--share", type=positive, default=0.5, help="share of the columns that are quads (default: 0.5)")


def make_hybrid(arguments):
    return makers.hybrid(*box_of(arguments, 2), cells_of(arguments, 2), arguments.share)


def add_tet_block(parser):
    add_box(parser)
    parser.add_argument("--ratio", type=numbers, metavar="RX,RY,RZ", help="size of the last cell over that of the first, for each axis (default: ones)")


def make_tet_block(arguments):
    return make_block(arguments, "tetrahedron4")


MAKERS = {
    "block": (add_block, make_block, "a box, graded"),
    "ring": (add_ring, make_ring, "part of an annulus, of quads"),
    "triangles": (add_triangles, make_triangles, "a box of nearly equilateral triangles"),
    "disk": (add_disk, make_disk, "a disk of triangles"),
    "hybrid": (add_hybrid, make_hybrid, "a box of quads and triangles"),
    "tet_block": (add_tet_block, make_tet_block, "a box of tetrahedra"),
}


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    for name, (add_options, _, purpose) in MAKERS.items():
        one = kinds.add_parser(name, help=purpose, description=purpose)
        add_options(one)
        one.add_argument("--distort", type=positive, default=0.0, metavar="SHARE", help="move inner nodes by up to this share of the shortest edge there")
        one.add_argument("--seed", type=int, default=1, help="start of the random numbers of --distort (default: 1)")
        one.add_argument("output", metavar="OUT.h5", help="mesh file to write")
    arguments = parser.parse_args(join_negative(sys.argv[1:] if words is None else list(map(str, words))))
    if arguments.distort > 0.5:
        parser.error("--distort: 0.5 at most, or nodes could meet")
    return arguments


def join_negative(words):
    """--lower -1,0 becomes --lower=-1,0, which argparse would take for an option"""
    joined = []
    for word in words:
        if re.match(r"-[\d.]", word) and joined and joined[-1].startswith("--") and "=" not in joined[-1]:
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


def make(arguments):
    """The mesh that the arguments ask for"""
    mesh = MAKERS[arguments.kind][1](arguments)
    if arguments.distort:
        makers.distort(mesh, arguments.distort, arguments.seed)
    for kind, word, found in faulty_elements(mesh):
        raise MeshError(f"these numbers make {len(found)} {word} elements (the first is {kind} {found[0] + 1}); take more cells or a milder shape")
    return mesh


def main(words=None):
    arguments = parse_arguments(words)
    mesh = make(arguments)
    write_mesh(arguments.output, mesh)
    print("\n".join(report(mesh)))
    return 0


if __name__ == "__main__":
    run_main(main)

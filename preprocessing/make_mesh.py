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
  make_mesh.py slope --height 4 --angle 45 --crest 5 --toe 11 slope.h5        groups soil, air; sides base, left, right, top
  make_mesh.py funnel --width 1 --outlet 0.3 --angle 60 funnel.h5             sides left_wall, right_wall, top, ..

`make_mesh.py KIND --help` tells the options of a kind. --distort moves inner nodes by up to that share of the shortest edge there.
"""
import preprocessing_paths  # noqa: F401 isort: skip (must come first)
import argparse
import re
import sys

import numpy as np

import mesh_makers as makers
import mesh_slopes as slopes
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
    parser.add_argument("--body", type=numbers, metavar="R,R", help="put the elements between these radii [m] into the group body")


def make_ring(arguments):
    if len(arguments.radii) != 2 or not 0 < arguments.radii[0] < arguments.radii[1]:
        raise MeshError("--radii: two numbers, 0 < inner < outer")
    if len(arguments.angles) != 2 or not 0 < arguments.angles[1] - arguments.angles[0] < 360:
        raise MeshError("--angles: two numbers, the last above the first by less than 360")
    nr, na = cells_of(arguments, 2)
    if arguments.angles[1] - arguments.angles[0] >= 180*na:
        raise MeshError("--cells: too few around")
    mesh = makers.ring(arguments.type, makers.graded(*arguments.radii, nr, arguments.ratio), makers.graded(*arguments.angles, na))
    if arguments.body is None:
        return mesh
    if len(arguments.body) != 2 or not arguments.body[0] < arguments.body[1]:
        raise MeshError("--body: two numbers, the second above the first")
    return slopes.body_of_ring(mesh, arguments.type, arguments.body)


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


def add_slope(parser):
    parser.add_argument("--height", type=positive, default=4.0, help="from toe to crest [m] (default: 4)")
    parser.add_argument("--angle", type=positive, default=45.0, help="of the face to the level [degrees] (default: 45)")
    parser.add_argument("--crest", type=positive, default=5.0, help="length of the level ground above [m] (default: 5)")
    parser.add_argument("--toe", type=positive, default=11.0, help="length of the level ground below [m] (default: 11)")
    parser.add_argument("--depth", type=positive, default=2.0, help="of the soil below the toe [m] (default: 2)")
    parser.add_argument("--layer", action="store_true", help="the soil is a layer of this depth on a base that follows the slope")
    parser.add_argument("--air", type=float, default=1.5, help="height of the room above the crest [m]; 0: none at all (default: 1.5)")
    parser.add_argument("--size", type=positive, default=0.5, help="of the elements [m], about (default: 0.5)")
    parser.add_argument("--ratio", type=positive, default=1.0, help="size far from the face and the surface over that there (default: 1)")
    parser.add_argument("--type", choices=makers.QUADS + makers.TRIANGLES, default="quad4", help="kind of elements (default: quad4)")


def make_slope(arguments):
    if arguments.angle > 80:
        raise MeshError("--angle: 80 degrees at most, or the elements of the face are needles")
    if not 0 <= arguments.air < float("inf"):
        raise MeshError("--air: 0 or more")
    return slopes.slope(arguments.type, arguments.height, arguments.angle, arguments.crest, arguments.toe, arguments.depth, arguments.air,
                        arguments.size, arguments.ratio, arguments.layer)


def add_funnel(parser):
    parser.add_argument("--width", type=positive, default=1.0, help="of the bin [m] (default: 1)")
    parser.add_argument("--outlet", type=positive, default=0.3, help="width of the outlet [m] (default: 0.3)")
    parser.add_argument("--angle", type=positive, default=60.0, help="of the inclined walls to the level [degrees] (default: 60)")
    parser.add_argument("--bin", type=positive, default=0.6, help="height of the upright walls [m] (default: 0.6)")
    parser.add_argument("--space", type=float, default=0.6, help="height of the room below the outlet [m]; 0: none (default: 0.6)")
    parser.add_argument("--space-width", type=positive, help="its width [m] (default: that of the bin)")
    parser.add_argument("--size", type=positive, default=0.05, help="of the elements [m], about (default: 0.05)")
    parser.add_argument("--type", choices=makers.QUADS + makers.TRIANGLES, default="quad4", help="kind of elements (default: quad4)")


def make_funnel(arguments):
    if arguments.outlet >= arguments.width:
        raise MeshError("--outlet must be smaller than --width")
    if arguments.angle > 85:
        raise MeshError("--angle: 85 degrees at most")
    if not 0 <= arguments.space < float("inf"):
        raise MeshError("--space: 0 or more")
    space_width = arguments.space_width or arguments.width
    if space_width < arguments.outlet:
        raise MeshError("--space-width: not less than --outlet")
    return slopes.funnel(arguments.type, arguments.width, arguments.outlet, arguments.angle, arguments.bin, arguments.space, space_width,
                         arguments.size)


MAKERS = {
    "block": (add_block, make_block, "a box, graded"),
    "ring": (add_ring, make_ring, "part of an annulus, of quads"),
    "triangles": (add_triangles, make_triangles, "a box of nearly equilateral triangles"),
    "disk": (add_disk, make_disk, "a disk of triangles"),
    "hybrid": (add_hybrid, make_hybrid, "a box of quads and triangles"),
    "slope": (add_slope, make_slope, "the ground of a slope, with soil and air"),
    "funnel": (add_funnel, make_funnel, "a bin with inclined walls and a room below"),
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
    words = list(map(str, sys.argv[1:] if words is None else words))
    arguments = parser.parse_args(join_negative(words))
    arguments.command = "make_mesh.py " + " ".join(w for w in words if w != arguments.output)
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
    write_mesh(arguments.output, mesh, arguments.command)
    print("\n".join(report(mesh)))
    return 0


if __name__ == "__main__":
    run_main(main)

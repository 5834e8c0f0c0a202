#!/usr/bin/env python3
"""Fill a body with particles: a particle file for a &body with shape = "file".

  fill_body.py slope.h5 --group soil --per-element 2 --density 2000 soil_particles.h5     the elements of a group of a mesh file
  fill_body.py part.stl --spacing 0.01 --density 7800 part_particles.h5                   the inside of a closed surface

Of a mesh each element is cut into PER-ELEMENT^d parts, a particle each, with the centroid, the volume and the corners of its part:
with basis = "cpdi2" neighbours share corners. Elements are lines, quads and hexahedra (particle_domain = "box") or triangles and
tetrahedra ("simplex"); --simplices cuts the former as well, and must where a body has both. A surface (STL, PLY, OBJ, .. all that
meshio reads; of triangles or quads) gets cubes whose middles lie inside, on a lattice through the origin.
"""
import preprocessing_paths  # noqa: F401 isort: skip (must come first)
import argparse
import re
import sys
from pathlib import Path

import h5py
import numpy as np

from closed_surfaces import enclosed_volume, lattice_inside, surface_of
from element_parts import cut_boxes, join_corners, parts_of
from foreign_meshes import read_foreign
from make_mesh import join_negative, numbers, positive, whole
from mesh_files import MeshError, put, read_mesh, run_main
from mesh_measures import SIMPLICES, faulty_elements, natural_nodes

MOST_POINTS = 200_000_000  # of a lattice; more would not fit into memory


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", help="mesh file (.h5), or a closed surface (.stl, .ply, ..)")
    parser.add_argument("output", metavar="OUT.h5", help="particle file to write")
    parser.add_argument("--density", type=positive, required=True, help="kg/m3")
    parser.add_argument("--velocity", type=numbers, metavar="VX,VY", help="at the start [m/s] (default: what the scene says)")
    mesh = parser.add_argument_group("of a mesh")
    mesh.add_argument("--group", action="append", default=[], help="group of elements to fill; may be repeated (default: all elements)")
    mesh.add_argument("--per-element", type=whole, help="particles along each axis of an element (default: 2)")
    mesh.add_argument("--simplices", action="store_true", help="cut the parts of quads and hexahedra into triangles and tetrahedra")
    surface = parser.add_argument_group("of a surface")
    surface.add_argument("--spacing", type=positive, help="edge of the cube of a particle [m]")
    surface.add_argument("--scale", type=positive, help="metres in a unit of the file (default: 1)")
    return parser.parse_args(join_negative(list(map(str, sys.argv[1:] if words is None else words))))


def refuse_options(arguments, names, why):
    """Options that would not act"""
    for name in names:
        if getattr(arguments, name.replace("-", "_")) not in (None, False, []):
            raise MeshError(f"--{name} is for {why}")


# ------------------------------------------------------------------------------------------------ meshes


def fill_mesh(arguments):
    """Particles of the elements of groups of a mesh file, and lines that tell about them"""
    refuse_options(arguments, ("spacing", "scale"), "a surface; a mesh file has its own elements")
    mesh = read_mesh(arguments.input)
    for name in arguments.group:
        if name not in mesh.element_groups:
            raise MeshError(f"--group {name}: {arguments.input} has no such group; it has: {' '.join(mesh.element_groups) or 'none'}")
    for kind, word, found in faulty_elements(mesh):
        raise MeshError(f"{arguments.input}: {kind} element {found[0] + 1} is {word}, as are {len(found) - 1} others; mend the mesh first")
    chosen = {}
    for kind, table in mesh.elements.items():
        wanted = np.isin(mesh.groups[kind], [mesh.element_groups.index(name) + 1 for name in arguments.group]) if arguments.group \
            else np.ones(len(table), bool)
        if wanted.any():
            chosen[kind] = table[wanted]
    simplices = [kind for kind in chosen if kind in SIMPLICES]
    if arguments.simplices and mesh.dim == 1:
        raise MeshError("--simplices: not in one dimension")
    if 0 < len(simplices) < len(chosen) and not arguments.simplices:
        raise MeshError(f"the body has {' and '.join(chosen)}, whose particles have different numbers of corners: give --simplices")
    found = []
    for kind, table in chosen.items():
        parts = parts_of(kind, mesh.nodes[table], arguments.per_element or 2)
        found.append(cut_boxes(parts[0]) if arguments.simplices and kind not in simplices else parts)
    corner, volume, position, half = map(np.concatenate, zip(*found))
    corner = join_corners(corner, 1e-9*np.ptp(mesh.nodes, axis=0).max())
    domain = "simplex" if simplices or arguments.simplices else "box"
    return particles(position, volume, half, corner), \
        [f"elements: {', '.join(f'{len(t)} {k}' for k, t in chosen.items())}; corners for particle_domain = \"{domain}\""]


def particles(position, volume, half, corner):
    """The datasets of a particle file; those of the corners one after the other"""
    return {"position": position, "volume": volume, "half_length": half, "corner": corner.reshape(len(corner), -1)}


# ------------------------------------------------------------------------------------------------ surfaces


def fill_surface(arguments):
    """Particles of a lattice inside a closed surface, and lines that tell about them"""
    refuse_options(arguments, ("group", "per-element", "simplices"), "a mesh file (.h5)")
    if arguments.spacing is None:
        raise MeshError("--spacing: the edge of the cube of a particle is needed to fill a surface")
    h = arguments.spacing
    triangles = (arguments.scale or 1.0)*surface_of(read_foreign(arguments.input), arguments.input)
    first = np.floor(triangles.min((0, 1))/h).astype(np.int64)
    counts = np.ceil(triangles.max((0, 1))/h).astype(np.int64) - first
    if np.prod(counts.astype(float)) > MOST_POINTS:
        raise MeshError(f"--spacing {h:g} makes a lattice of {' x '.join(map(str, counts))}; take a larger one")
    inside = lattice_inside(triangles, (first + 0.5)*h, h, tuple(counts))
    cell = np.argwhere(inside) + first
    if not len(cell):
        raise MeshError(f"--spacing {h:g}: no middle of a cube lies inside {arguments.input}; take a smaller one")
    position = (cell + 0.5)*h
    corner = (cell[:, None, :] + (natural_nodes("hexahedron8") + 1)/2)*h
    volume = abs(enclosed_volume(triangles))
    return particles(position, np.full(len(cell), h**3), np.full((len(cell), 3), 0.5*h), corner), \
        [f"surface: {len(triangles)} triangles around {volume:.6g} m3; the particles have {100*(len(cell)*h**3/volume - 1):+.2f} % of that more"]


# ------------------------------------------------------------------------------------------------ all of it


def write_particles(path, table):
    """A particle file; the same bytes for the same particles"""
    try:
        file = h5py.File(path, "w", libver=("earliest", "v108"))
    except OSError as problem:
        raise MeshError(f"{path}: cannot be written ({problem})") from None
    with file:
        for name, values in table.items():
            put(file, name, values, np.float64)


def main(words=None):
    arguments = parse_arguments(words)
    is_mesh = re.fullmatch(r"\.(h5|hdf5)", Path(arguments.input).suffix.lower())
    table, told = (fill_mesh if is_mesh else fill_surface)(arguments)
    table["mass"] = arguments.density*table["volume"]
    dim = table["position"].shape[1]
    if arguments.velocity:
        if len(arguments.velocity) != dim:
            raise MeshError(f"--velocity: {len(arguments.velocity)} numbers for a body in {dim}D")
        table["velocity"] = np.tile(arguments.velocity, (len(table["mass"]), 1))
    write_particles(arguments.output, table)
    low, high = table["position"].min(0), table["position"].max(0)
    print("\n".join([*told, f"{len(table['mass'])} particles, volume {table['volume'].sum():.8g} m{('', '2', '3')[dim - 1]}, mass "
                     f"{table['mass'].sum():.8g} kg, between " + " and ".join("(" + ", ".join(f"{x:.6g}" for x in e) + ")" for e in (low, high)) + " m"]))
    return 0


if __name__ == "__main__":
    run_main(main)

"""Meshes that follow the ground and walls: a slope with soil and air, a funnel; each function returns a Mesh with all sides named."""
import numpy as np

from mesh_files import Mesh, MeshError
from mesh_makers import graded, halved, lattice, name_sides, number_places


def steps(length, size):
    """Cells of about `size` along a length"""
    return max(1, round(length/size))


def slope(kind, height, angle, crest, toe, depth, air, size, ratio=1.0, layer=False):
    """A slope that falls from left to right, with columns that stand upright and rows that follow the surface

    The surface is level over `crest` [m], falls by `height` at `angle` [degrees] and is level over `toe`. Below the toe the soil is
    `depth` deep, on a level base; with `layer` it is so deep everywhere, on a base that follows the surface. Above it up to `air` over
    the crest there is room that material can move into. Cells grow away from the face and the surface, the last to `ratio` times the first.
    Groups soil and air; sides left, right, base and top, without air crest, slope and toe for top.
    """
    run = height/np.tan(np.radians(angle))
    columns = [steps(crest, size), steps(run, size), steps(toe, size)]
    x_axis = np.concatenate([graded(0.0, crest, columns[0], 1/ratio), graded(crest, crest + run, columns[1])[1:],
                             graded(crest + run, crest + run + toe, columns[2], ratio)[1:]])
    soil_rows = steps(depth if layer else depth + 0.5*height, size)
    air_rows = steps(air + 0.5*height, size) if air > 0 else 0
    levels = graded(0.0, 1.0, soil_rows, 1/ratio)
    if air_rows:
        levels = np.concatenate([levels, graded(1.0, 2.0, air_rows, ratio)[1:]])
    cells = (len(x_axis) - 1, len(levels) - 1)
    table, place = lattice(kind, cells)
    x, level = halved(x_axis)[place[:, 0]], halved(levels)[place[:, 1]]
    surface = depth + height*np.clip((crest + run - x)/run, 0.0, 1.0)
    base = surface - depth if layer else np.zeros_like(x)
    top = depth + height + air
    below = np.minimum(level, 1.0)
    y = np.where(level <= 1, (1 - below)*base + below*surface, (2 - level)*surface + (level - 1)*top)
    is_soil = place[table, 1].max(1) <= 2*soil_rows
    mesh = Mesh(np.stack([x, y], 1), {kind: table}, ["soil", "air"][:2 if air_rows else 1], {kind: np.where(is_soil, 1, 2)})
    i, j = place.T
    rules = [("base", j == 0), ("left", i == 0), ("right", i == 2*cells[0])]
    if air_rows:
        return name_sides(mesh, [*rules, ("top", j == 2*cells[1])])
    on_top, face = j == 2*cells[1], (2*columns[0], 2*(columns[0] + columns[1]))
    return name_sides(mesh, [*rules, ("crest", on_top & (i <= face[0])), ("slope", on_top & (i >= face[0]) & (i <= face[1])),
                             ("toe", on_top & (i >= face[1]))])


def funnel(kind, width, outlet, angle, fill, space, space_width, size):
    """A bin of `width` [m] and height `fill` over walls that close to the `outlet` at `angle` to the level [degrees]; x = 0 in the middle

    The outlet lies at y = 0. Below it is a room of height `space` and width `space_width`; without one the outlet is a named side.
    Groups bin, hopper, space; sides top, left_wall, right_wall, and outlet or ceiling, space_left, space_right, floor.
    """
    closing = 0.5*(width - outlet)*np.tan(np.radians(angle))
    across = max(4, steps(0.5*(width + outlet), size))
    beside = steps(0.5*(space_width - outlet), size) if space > 0 and space_width > outlet else 0
    rows = [steps(space, size) if space > 0 else 0, steps(closing, size), steps(fill, size)]
    table, place = lattice(kind, (across + 2*beside, sum(rows)))
    cell = place[table].min(1)//2
    room = cell[:, 1] < rows[0]
    keep = room | ((cell[:, 0] >= beside) & (cell[:, 0] < beside + across))
    group = np.select([room, cell[:, 1] < rows[0] + rows[1]], [3, 2], 1)[keep]
    table, place = number_places(place[table[keep]])
    levels = [graded(0.0, closing, rows[1]), graded(closing, closing + fill, rows[2])[1:]]
    if rows[0]:
        levels.insert(0, graded(-space, 0.0, rows[0])[:-1])
    i, j = place.T
    y = halved(np.concatenate(levels))[j]
    half = 0.5*outlet + 0.5*(width - outlet)*np.clip(y/closing, 0.0, 1.0)
    x = half*((i - 2*beside)/across - 1)
    if beside:
        edge = halved(graded(0.5*outlet, 0.5*space_width, beside))
        left, right = i < 2*beside, i > 2*(beside + across)
        x[left], x[right] = -edge[2*beside - i[left]], edge[i[right] - 2*(beside + across)]
    names = ["bin", "hopper", "space"][:3 if rows[0] else 2]
    mesh = Mesh(np.stack([x, y], 1), {kind: table}, names, {kind: group})
    bottom, left, right = j == 2*rows[0], i == 2*beside, i == 2*(beside + across)
    rules = [("top", j == 2*sum(rows)), ("left_wall", left & (j >= 2*rows[0])), ("right_wall", right & (j >= 2*rows[0]))]
    if not rows[0]:
        return name_sides(mesh, [*rules, ("outlet", bottom)])
    return name_sides(mesh, [*rules, ("ceiling", bottom & ((i <= 2*beside) | (i >= 2*(beside + across)))), ("floor", j == 0),
                             ("space_left", i == 0), ("space_right", i == 2*(across + 2*beside))])


def body_of_ring(mesh, kind, radii):
    """Put the elements between two radii [m] into the group body"""
    distance = np.linalg.norm(mesh.nodes, axis=1)[mesh.elements[kind][:, :4]]
    tolerance = 1e-9*distance.max()
    inside = (distance >= radii[0] - tolerance).all(1) & (distance <= radii[1] + tolerance).all(1)
    met = [np.abs(distance - r).min() <= tolerance for r in radii]
    if not all(met) or not inside.any():
        raise MeshError("--body: both radii must be radii of rows of nodes; change --radii, --cells or --ratio")
    mesh.element_groups, mesh.groups = ["body"], {kind: inside.astype(np.int64)}
    return mesh

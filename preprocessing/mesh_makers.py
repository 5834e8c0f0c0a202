"""Meshes of simple regions: blocks, rings, disks, slopes, funnels; each function returns a Mesh with all its sides named.

Most are lattices: nodes stand at places of a box of whole numbers and are put where a function says. A side belongs to the first
name whose places of the lattice hold all its corners.
"""
import math

import numpy as np

from mesh_files import KINDS, Mesh, MeshError, boundary_sides, unique_rows
from mesh_measures import least_jacobians

QUADS = ("quad4", "quad8", "quad9")
TRIANGLES = ("triangle3", "triangle6")
QUADRATIC = ("triangle6", "quad8", "quad9")
AXIS_SIDES = ("x_low", "x_high", "y_low", "y_high", "z_low", "z_high")
NEVER = "a side without a name"


# ------------------------------------------------------------------------------------------------ lattices


def graded(lower, upper, cells, ratio=1.0):
    """Places (cells + 1,) from lower to upper [m]; each interval is the one before times the same number, the last `ratio` times the first"""
    growth = ratio**(1/(cells - 1)) if cells > 1 else 1.0
    steps = growth**np.arange(cells)
    places = lower + (upper - lower)*np.concatenate([[0.0], np.cumsum(steps)])/steps.sum()
    places[-1] = upper
    return places


def halved(axis):
    """The same places with the middle of each interval between them"""
    both = np.empty(2*len(axis) - 1)
    both[::2], both[1::2] = axis, 0.5*(axis[1:] + axis[:-1])
    return both


def lattice_quads(kind, cells):
    """Tables of quads or triangles over a lattice of cells, and the places (n, 2) of its nodes, counted in halves of cells

    Triangles have diagonals that alternate. Nodes that no element has are left out.
    """
    nx, ny = cells
    i, j = (2*a.ravel() for a in np.meshgrid(np.arange(nx), np.arange(ny)))  # x runs fastest
    around = {name: np.stack([i + di, j + dj], 1) for name, (di, dj) in
              {"a": (0, 0), "b": (2, 0), "c": (2, 2), "d": (0, 2), "ab": (1, 0), "bc": (2, 1), "cd": (1, 2), "da": (0, 1),
               "m": (1, 1)}.items()}
    if kind in QUADS:
        names = ("a", "b", "c", "d", "ab", "bc", "cd", "da", "m")[:KINDS[kind].nodes]
        return number_places(np.stack([around[n] for n in names], 1))
    halves = [(("a", "b", "c", "ab", "bc", "m"), ("a", "c", "d", "m", "cd", "da")),
              (("a", "b", "d", "ab", "m", "da"), ("b", "c", "d", "bc", "cd", "m"))]
    odd = ((i + j)//2) % 2 == 1
    places = np.empty((nx*ny, 2, KINDS[kind].nodes, 2), np.int64)
    for half in (0, 1):
        for k in range(KINDS[kind].nodes):
            places[:, half, k] = np.where(odd[:, None], around[halves[1][half][k]], around[halves[0][half][k]])
    return number_places(places.reshape(-1, KINDS[kind].nodes, 2))


def lattice_solids(kind, cells):
    """The same for hexahedra, or for cubes cut into five tetrahedra each, mirrored from cube to cube"""
    k, j, i = (2*a.ravel() for a in np.meshgrid(*(np.arange(n) for n in cells[::-1]), indexing="ij"))
    first = np.stack([i, j, k], 1)
    corner = 2*np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
    if kind == "hexahedron8":
        return number_places(first[:, None, :] + corner)
    even = np.array([(0, 1, 2, 5), (0, 2, 3, 7), (0, 5, 7, 4), (2, 7, 5, 6), (0, 2, 7, 5)])
    mirror = np.array([1, 0, 3, 2, 5, 4, 7, 6])  # across x
    odd = mirror[even][:, [0, 2, 1, 3]]
    pieces = np.where((((i + j + k)//2) % 2 == 1)[:, None, None], odd, even)
    return number_places((first[:, None, None, :] + corner[pieces]).reshape(-1, 4, 3))


def number_places(places):
    """Number the places (elements, nodes, dim) of a lattice, x fastest: table of elements, places (n, dim) of the nodes"""
    elements, nodes, dim = places.shape
    flat = places.reshape(-1, dim)
    first, which, _ = unique_rows(flat[:, ::-1])
    return which.reshape(elements, nodes), flat[first]


def lattice(kind, cells):
    """Table and places of a lattice of any kind, in halves of cells"""
    if kind == "line2":
        first = 2*np.arange(cells[0])[:, None, None]
        return number_places(first + np.array([[0], [2]]))
    return (lattice_solids if KINDS[kind].dim == 3 else lattice_quads)(kind, cells)


def name_sides(mesh, rules):
    """Name all boundary sides: of `rules` (name, nodes it may have) the first one that holds all corners of a side gives its name"""
    sides = boundary_sides(mesh)
    group = np.zeros(len(sides), np.int64)
    for number, (_, nodes) in enumerate(rules, 1):
        all_in = np.where(sides >= 0, np.asarray(nodes)[np.maximum(sides, 0)], True).all(1)
        group[(group == 0) & all_in] = number
    assert (group > 0).all(), NEVER
    used = [number for number in range(1, len(rules) + 1) if (group == number).any()]
    names = [rules[number - 1][0] for number in used]
    mesh.side_groups = list(dict.fromkeys(names))
    number_of = {number: mesh.side_groups.index(name) + 1 for number, name in zip(used, names)}
    mesh.sides, mesh.side_group = sides, np.array([number_of[g] for g in group])
    return mesh


def box_rules(place, cells, names=AXIS_SIDES):
    """Rules of `name_sides` for the ends of a lattice"""
    return [(names[2*k + end], place[:, k] == end*2*cells[k]) for k in range(len(cells)) for end in (0, 1)]


# ------------------------------------------------------------------------------------------------ regions


def block(kind, axes):
    """A box with these places of nodes along each axis [m], graded as they are"""
    cells = [len(axis) - 1 for axis in axes]
    table, place = lattice(kind, cells)
    nodes = np.stack([halved(np.asarray(axis, float))[place[:, k]] for k, axis in enumerate(axes)], 1)
    return name_sides(Mesh(nodes, {kind: table}), box_rules(place, cells))


def triangle_rows(lower, upper, size):
    """A box of nearly equilateral triangles: every other row of nodes is shifted by half a triangle"""
    (x0, y0), (x1, y1) = lower, upper
    across = max(1, round((x1 - x0)/size))
    rows = max(1, round((y1 - y0)/(size*np.sqrt(0.75))))
    h = (x1 - x0)/across
    chains, nodes = [], []
    for j, y in enumerate(np.linspace(y0, y1, rows + 1)):
        x = np.linspace(x0, x1, across + 1) if j % 2 == 0 else np.concatenate([[x0], x0 + h*(np.arange(across) + 0.5), [x1]])
        chains.append(np.arange(len(x)) + len(nodes))
        nodes += [(a, y) for a in x]
    nodes = np.array(nodes)
    table = np.concatenate([strip(nodes, low, high) for low, high in zip(chains[:-1], chains[1:])])
    mesh = Mesh(nodes, {"triangle3": table})
    x, y = nodes.T
    return name_sides(mesh, [("x_low", x == x0), ("x_high", x == x1), ("y_low", y == y0), ("y_high", y == y1)])


def strip(nodes, low, high):
    """Triangles between two chains of nodes, `high` to the left of `low`; each step takes the shorter diagonal"""
    found, i, j = [], 0, 0
    (below, above), (low, high) = (nodes[low].tolist(), nodes[high].tolist()), (low.tolist(), high.tolist())
    while i < len(low) - 1 or j < len(high) - 1:
        if j == len(high) - 1:
            forward = True
        elif i == len(low) - 1:
            forward = False
        else:
            forward = math.dist(below[i + 1], above[j]) <= math.dist(below[i], above[j + 1])*(1 + 1e-9)  # ties do not hang on round-off
        if forward:
            found.append((low[i], low[i + 1], high[j]))
            i += 1
        else:
            found.append((low[i], high[j + 1], high[j]))
            j += 1
    return np.array(found)


def ring(kind, radii, angles):
    """Part of an annulus: places of nodes along the radius [m] and around [degrees]; sides inner, outer, axis_x, axis_y"""
    cells = (len(radii) - 1, len(angles) - 1)
    table, place = lattice(kind, cells)
    r, angle = halved(np.asarray(radii, float))[place[:, 0]], halved(np.asarray(angles, float))[place[:, 1]]
    nodes = np.stack([r*cos_of(angle), r*cos_of(angle - 90)], 1)
    first = "axis_x" if angles[0] == 0 else "first_ray"
    last = "axis_y" if angles[-1] == 90 else "last_ray"
    return name_sides(Mesh(nodes, {kind: table}), box_rules(place, cells, ("inner", "outer", first, last)))


def cos_of(degrees):
    """Cosine with exact zeros and ones at right angles"""
    turned = np.abs(np.mod(degrees + 180, 360) - 180)  # 0 .. 180
    return np.where(turned == 90, 0.0, np.cos(np.radians(turned)))


def disk(center, radius, rings, box=None):
    """A disk of triangles, in rings of 6, 12, 18, .. nodes; side rim

    With `box`, half the edge of a square around it [m], the square is meshed as well (rings of 8, 16, 24, .. nodes): groups disk and
    outside, sides x_low, x_high, y_low, y_high.
    """
    most = 6 if box is None else 8
    nodes, chains = [np.zeros((1, 2))], [np.zeros(1, np.int64)]
    count = 1
    for k in range(1, rings + 1):
        angle = 360*np.arange(most*k)/(most*k)
        count = add_ring(nodes, chains, count, radius*k/rings*np.stack([cos_of(angle), cos_of(angle - 90)], 1))
    if box is not None:
        on_rim = nodes[-1]/radius
        on_square = on_rim/np.abs(on_rim).max(1)[:, None]
        layers = max(1, round((box - radius)/(radius/rings)))
        for k in range(1, layers + 1):
            count = add_ring(nodes, chains, count, ((layers - k)*radius*on_rim + k*box*on_square)/layers)
    places = np.concatenate(nodes)
    tables = [strip(places, outer, inner) for inner, outer in zip(chains[:-1], chains[1:])]
    mesh = Mesh(places + np.asarray(center, float), {"triangle3": np.concatenate(tables)})
    if box is None:
        return name_sides(mesh, [("rim", np.ones(len(places), bool))])
    mesh.element_groups = ["disk", "outside"]
    mesh.groups["triangle3"][:] = 2
    mesh.groups["triangle3"][:sum(map(len, tables[:rings]))] = 1
    return name_sides(mesh, [(name, np.abs(places[:, k] - end*box) < 1e-9*box)
                             for name, k, end in (("x_low", 0, -1), ("x_high", 0, 1), ("y_low", 1, -1), ("y_high", 1, 1))])


def add_ring(nodes, chains, count, places):
    """Append a closed ring of nodes; the number of nodes then"""
    nodes.append(places)
    chains.append(np.append(np.arange(len(places)), 0) + count)
    return count + len(places)


def hybrid(lower, upper, cells, share):
    """A box with quads in the lower share of x and triangles beyond, which share nodes; groups quads and triangles"""
    split = round(share*cells[0])
    if not 0 < split < cells[0]:
        raise MeshError(f"share {share:g} of {cells[0]} columns leaves no quads or no triangles; take one between")
    quads, place_of_quads = lattice("quad4", (split, cells[1]))
    triangles, place_of_triangles = lattice("triangle3", (cells[0] - split, cells[1]))
    place_of_triangles = place_of_triangles + np.array([2*split, 0])
    all_places = np.concatenate([place_of_quads[quads].reshape(-1, 2), place_of_triangles[triangles].reshape(-1, 2)])
    which, place = number_places(all_places[:, None, :])
    quads, triangles = which[:quads.size].reshape(quads.shape), which[quads.size:].reshape(triangles.shape)
    axes = [graded(lower[k], upper[k], cells[k]) for k in (0, 1)]
    nodes = np.stack([halved(axes[k])[place[:, k]] for k in (0, 1)], 1)
    mesh = Mesh(nodes, {"quad4": quads, "triangle3": triangles}, ["quads", "triangles"],
                {"quad4": np.ones(len(quads)), "triangle3": np.full(len(triangles), 2)})
    return name_sides(mesh, box_rules(place, cells))


# ------------------------------------------------------------------------------------------------ distortion


def distort(mesh, share, seed):
    """Move the inner corners by up to `share` of the shortest edge there, in directions of chance; nodes between corners follow

    Corners of elements that would be twisted are drawn back by halves until no Jacobian falls below a tenth of its mean.
    """
    corners = {kind: table[:, :KINDS[kind].corners] for kind, table in mesh.elements.items()}
    shortest = np.full(len(mesh.nodes), np.inf)
    for kind, table in corners.items():
        for side in KINDS[kind].sides:
            for a, b in zip(side, side[1:] + side[:1]) if len(side) > 1 else ((0, 1),):
                length = np.linalg.norm(mesh.nodes[table[:, a]] - mesh.nodes[table[:, b]], axis=1)
                for end in (a, b):
                    np.minimum.at(shortest, table[:, end], length)
    chance = np.random.RandomState(seed)  # this one promises the same numbers for ever
    direction = chance.standard_normal(mesh.nodes.shape)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    move = share*chance.random_sample(len(mesh.nodes))[:, None]*direction*np.where(np.isfinite(shortest), shortest, 0.0)[:, None]
    sides = boundary_sides(mesh)
    move[np.unique(sides[sides >= 0])] = 0.0
    before = mesh.nodes
    for _ in range(20):
        mesh.nodes = before + carry_along(mesh, move)
        bad = np.unique(np.concatenate([table[least_jacobians(kind, mesh.nodes[table])[0] < 0.1].ravel()
                                        for kind, table in mesh.elements.items()]))
        if not len(bad):
            break
        move[bad] *= 0.5
    return mesh


def carry_along(mesh, move):
    """Moves (n, dim) of all nodes from those of the corners: middles of sides take the mean of two, centres that of four"""
    full = move.copy()
    for kind, table in mesh.elements.items():
        if kind not in QUADRATIC:
            continue
        corners = KINDS[kind].corners
        for s in range(corners):
            full[table[:, corners + s]] = 0.5*(move[table[:, s]] + move[table[:, (s + 1) % corners]])
        if kind == "quad9":
            full[table[:, 8]] = move[table[:, :4]].mean(1)
    return full



"""Which points of a lattice lie inside a closed surface of triangles.

Columns of the lattice are cut with the triangles; signs of crossings above a point add up to how often the surface goes around it.
A column that meets an edge or a corner belongs to one of the triangles there: signs of areas are the same whichever triangle asks,
and a zero counts as if the column stood a hair to the right (and a far smaller one up).
"""
import numpy as np

from mesh_files import MeshError


def surface_of(foreign, path):
    """Corners (n, 3, 3) of the triangles of a file; quads are cut; the surface must be closed, its triangles in one sense"""
    triangles = [np.asarray(table)[:, list(part)] for kind, table in foreign.blocks
                 for part in {"triangle": ((0, 1, 2),), "quad": ((0, 1, 2), (0, 2, 3))}.get(kind, ())]
    others = [kind for kind, _ in foreign.blocks if kind not in ("triangle", "quad", "line", "vertex")]
    if not triangles or others:
        raise MeshError(f"{path}: a closed surface of triangles or quads is needed; it has " + (" ".join(dict.fromkeys(others)) or "none"))
    triangles = np.concatenate(triangles)
    _, which = np.unique(foreign.points, axis=0, return_inverse=True)  # STL has each corner once for every triangle
    which = which.ravel()[triangles]
    which = which[(which != np.roll(which, 1, axis=1)).all(1)]  # not those that have become lines
    edges = np.stack([which, np.roll(which, -1, axis=1)], 2).reshape(-1, 2)
    steps = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    _, place = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    open_edges = np.bincount(place.ravel(), weights=steps) != 0
    if open_edges.any():
        raise MeshError(f"{path}: the surface is not closed: {int(open_edges.sum())} of {len(open_edges)} edges have no triangle on the other "
                        "side, or one that looks the other way; mend it where it was made")
    points = np.unique(foreign.points, axis=0)
    return points[which]


def enclosed_volume(triangles):
    """Volume inside a closed surface, positive if it looks outward [m3]"""
    x = triangles - triangles.mean((0, 1))
    return np.linalg.det(x).sum()/6


def edge_sign(a, b, x, y):
    """On which side of the line from a to b the points are: 1 left, -1 right, the opposite for b to a; 0 only for a = b"""
    turned = tuple(a[:2]) > tuple(b[:2])
    if turned:
        a, b = b, a
    dx, dy = b[0] - a[0], b[1] - a[1]
    sign = np.sign(dx*(y - a[1]) - dy*(x - a[0]))
    sign[sign == 0] = np.sign(-dy) or np.sign(dx)
    return -sign if turned else sign


def lattice_inside(triangles, lower, spacing, counts):
    """Whether the points lower + spacing*(i, j, k) are inside: (counts)"""
    crossing = np.zeros((counts[0], counts[1], counts[2] + 1), np.int64)
    scaled = (triangles - lower)/spacing  # points are whole numbers
    low, high = np.ceil(scaled.min(1)).astype(int), np.floor(scaled.max(1)).astype(int)
    for corner, first, last in zip(scaled, np.maximum(low, 0), np.minimum(high, np.array(counts) - 1)):
        if first[0] > last[0] or first[1] > last[1]:
            continue
        i, j = (a.ravel() for a in np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1)))
        x, y = i.astype(float), j.astype(float)
        signs = [edge_sign(corner[k], corner[(k + 1) % 3], x, y) for k in range(3)]
        met = (signs[0] == signs[1]) & (signs[1] == signs[2]) & (signs[0] != 0)
        if not met.any():
            continue
        normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
        if normal[2] == 0:
            continue
        x, y = x[met], y[met]
        z = corner[0, 2] - ((x - corner[0, 0])*normal[0] + (y - corner[0, 1])*normal[1])/normal[2]
        below = np.clip(np.ceil(z), 0, counts[2]).astype(int)  # so many points of the column lie below
        np.add.at(crossing, (i[met], j[met], below), signs[0][met].astype(int))
    if crossing.sum(axis=2).any():  # round-off where many thin triangles meet
        raise MeshError(f"{int((crossing.sum(axis=2) != 0).sum())} columns of the lattice meet the surface too near to its corners; change the spacing a little")
    return np.cumsum(crossing[:, :, ::-1], axis=2)[:, :, -2::-1] != 0

"""Sizes and shapes of elements: shape functions, volumes, centroids, smallest Jacobians, quality, and a report of a mesh."""
from itertools import combinations, permutations, product

import numpy as np

from mesh_files import KINDS, boundary_sides

# Exponents of the monomials that span the shape functions of a kind, and the natural coordinates of its nodes: [-1, 1] along each
# axis, for simplices the barycentric coordinates of nodes 2, 3 (, 4)
SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))
MIDDLES = ((0, -1), (1, 0), (0, 1), (-1, 0))
SERENDIPITY = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (2, 1), (1, 2))
SPACES = {
    "line2": (((0,), (1,)), ((-1,), (1,))),
    "triangle3": (((0, 0), (1, 0), (0, 1)), ((0, 0), (1, 0), (0, 1))),
    "triangle6": (((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2)), ((0, 0), (1, 0), (0, 1), (0.5, 0), (0.5, 0.5), (0, 0.5))),
    "quad4": (SERENDIPITY[:4], SQUARE),
    "quad8": (SERENDIPITY, SQUARE + MIDDLES),
    "quad9": ((*SERENDIPITY, (2, 2)), (*SQUARE, *MIDDLES, (0, 0))),
    "tetrahedron4": (((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)), ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))),
    "hexahedron8": (tuple(product((0, 1), repeat=3)), tuple((*xy, z) for z in (-1, 1) for xy in SQUARE)),
}
SIMPLICES = ("triangle3", "triangle6", "tetrahedron4")
FLAT, LEAST_JACOBIAN, LEAST_HEIGHT = 1e-10, 0.05, 0.01  # volume over size^dim; det dx/dxi over its mean; height of a simplex over its edge


def natural_nodes(kind):
    """Natural coordinates (nodes, dim) of the nodes of a kind"""
    return np.array(SPACES[kind][1], float)


def monomials(kind, xi, along=None):
    """The monomials of a kind at points xi (n, dim), or their slopes along one axis: (n, nodes)"""
    powers = np.array(SPACES[kind][0])
    factor = np.ones(len(powers))
    if along is not None:
        factor = powers[:, along].astype(float)
        powers = powers.copy()
        powers[:, along] = np.maximum(powers[:, along] - 1, 0)
    return factor*np.prod(np.asarray(xi, float)[:, None, :]**powers[None], axis=2)


def shape_values(kind, xi):
    """Shape functions at points xi (n, dim): (n, nodes)"""
    return monomials(kind, xi) @ np.linalg.inv(monomials(kind, natural_nodes(kind)))


def shape_slopes(kind, xi):
    """Their slopes in natural coordinates: (n, nodes, dim)"""
    inverse = np.linalg.inv(monomials(kind, natural_nodes(kind)))
    return np.stack([monomials(kind, xi, k) @ inverse for k in range(KINDS[kind].dim)], axis=2)


def jacobians(kind, places, xi):
    """det dx/dxi of elements with nodes at `places` (elements, nodes, dim) at points xi: (elements, points)"""
    slopes = shape_slopes(kind, xi)
    parts = [places[k:k + 20000] for k in range(0, len(places), 20000)]  # so many at a time, for the memory
    return np.concatenate([np.linalg.det(np.einsum("enk,pnj->epkj", part, slopes)) for part in parts])


def quadrature(kind):
    """Points and weights that integrate x det dx/dxi of every kind exactly: (n, dim), (n,)"""
    dim = KINDS[kind].dim
    one, weight = np.polynomial.legendre.leggauss(2 if KINDS[kind].nodes == KINDS[kind].corners else 4)
    points = np.array(list(product(one, repeat=dim)))
    weights = np.prod(list(product(weight, repeat=dim)), axis=1)
    if kind not in SIMPLICES:
        return points, weights
    u = 0.5 + 0.5*points  # the unit cube folded onto the simplex
    folded, shrink = u.copy(), np.ones(len(u))
    for k in range(1, dim):
        left = np.prod(1 - u[:, :k], axis=1)
        folded[:, k] *= left
        shrink *= left
    return folded, weights*shrink*0.5**dim


def volumes(kind, places):
    """Signed volumes (elements,) of elements with nodes at `places` (elements, nodes, dim) [m, m2, m3]"""
    points, weights = quadrature(kind)
    return jacobians(kind, places, points) @ weights


def least_jacobians(kind, places):
    """Smallest and largest det dx/dxi of each element over nodes and quadrature points, over its mean: (elements,), (elements,)"""
    points, weights = quadrature(kind)
    found = jacobians(kind, places, np.vstack([natural_nodes(kind), points]))
    mean = np.abs(volumes(kind, places))/weights.sum()
    found /= np.where(mean > 0, mean, 1.0)[:, None]
    return found.min(1), found.max(1)


def qualities(kind, places):
    """Scaled Jacobian at the worst corner, 1 for a square, cube or equilateral simplex, below 0 if turned inside out: (elements,)"""
    if KINDS[kind].dim == 1:
        return np.sign(places[:, 1, 0] - places[:, 0, 0])
    corners = KINDS[kind].corners
    beside = [sorted({n for side in KINDS[kind].sides for a, b in zip(side, side[1:] + side[:1]) for n in (a, b)
                      if c in (a, b) and n != c}) for c in range(corners)]
    ideal = {"triangle3": np.sqrt(0.75), "triangle6": np.sqrt(0.75), "tetrahedron4": np.sqrt(0.5)}.get(kind, 1.0)
    reference = natural_nodes(kind)
    worst = np.full(len(places), np.inf)
    for c in range(corners):
        for order in permutations(beside[c]):  # the order of the axes, as the natural element has it
            if np.linalg.det(reference[list(order)] - reference[c]) > 0:
                break
        arms = places[:, order, :] - places[:, c, None, :]
        lengths = np.prod(np.linalg.norm(arms, axis=2), axis=1)
        worst = np.minimum(worst, np.linalg.det(arms)/np.where(lengths > 0, lengths, 1.0)/ideal)
    return worst


def slenderness(kind, places):
    """Smallest height of each simplex over its longest edge: (elements,)"""
    corners = places[:, :KINDS[kind].corners]
    longest = np.max([np.linalg.norm(corners[:, a] - corners[:, b], axis=1) for a, b in combinations(range(corners.shape[1]), 2)], axis=0)
    content = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))  # times 2 in the plane, 6 in space
    base = longest
    if corners.shape[2] == 3:
        faces = corners[:, list(KINDS[kind].sides)]
        base = np.linalg.norm(np.cross(faces[:, :, 1] - faces[:, :, 0], faces[:, :, 2] - faces[:, :, 0]), axis=2).max(1)
    return content/np.where(base*longest > 0, base*longest, 1.0)


def faulty_elements(mesh):
    """Elements that cannot be used: a list of (kind, "turned", "twisted", "flat" or "misshapen", numbers from 0); limits as gimp.x has them"""
    found = []
    for kind, table in mesh.elements.items():
        places = mesh.nodes[table]
        least, most = least_jacobians(kind, places)
        flat = np.abs(volumes(kind, places)) <= FLAT*np.ptp(places, axis=1).max(1)**mesh.dim
        slender = slenderness(kind, places) < LEAST_HEIGHT if kind in SIMPLICES else np.zeros(len(table), bool)
        for word, which in (("flat", flat), ("turned", ~flat & (most < 0)), ("twisted", ~flat & (most >= 0) & (least <= 0)),
                            ("misshapen", ~flat & (least > 0) & ((least < LEAST_JACOBIAN) | slender))):
            if which.any():
                found.append((kind, word, np.flatnonzero(which)))
    return found


def report(mesh):
    """Lines that tell what a mesh is made of"""
    lines = [f"{len(mesh.nodes)} nodes in {mesh.dim}D, {mesh.count()} elements: "
             + ", ".join(f"{len(table)} {kind}" for kind, table in mesh.elements.items())]
    low, high = mesh.nodes.min(0), mesh.nodes.max(0)
    lines.append("box " + " x ".join(f"[{a:.6g}, {b:.6g}]" for a, b in zip(low, high)) + " m")
    size = np.concatenate([np.abs(volumes(kind, mesh.nodes[table])) for kind, table in mesh.elements.items()])
    quality = np.concatenate([qualities(kind, mesh.nodes[table]) for kind, table in mesh.elements.items()])
    lines.append(f"{('length', 'area', 'volume')[mesh.dim - 1]} {size.sum():.8g} {('m', 'm2', 'm3')[mesh.dim - 1]}"
                 + f", sizes {size.min()**(1/mesh.dim):.4g} to {size.max()**(1/mesh.dim):.4g} m (median {np.median(size)**(1/mesh.dim):.4g} m)"
                 + f", quality {quality.min():.3f} to {quality.max():.3f} (1 is best)")
    for k, name in enumerate(mesh.element_groups, 1):
        counts = {kind: int((group == k).sum()) for kind, group in mesh.groups.items()}
        lines.append(f"element group {name}: " + ", ".join(f"{n} {kind}" for kind, n in counts.items() if n))
    outside = len(boundary_sides(mesh))
    for k, name in enumerate(mesh.side_groups, 1):
        lines.append(f"side {name}: {int((mesh.side_group == k).sum())} of {outside} boundary sides")
    if len(mesh.sides) < outside:
        lines.append(f"without a name: {outside - len(mesh.sides)} of {outside} boundary sides")
    return lines

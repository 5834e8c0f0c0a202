"""Elements of a mesh cut into parts, one for each particle: corners, contents, centroids, half lengths."""
from itertools import permutations, product

import numpy as np

from mesh_files import KINDS, unique_rows
from mesh_measures import SIMPLICES, natural_nodes, quadrature, shape_slopes, shape_values

LINEAR_BOX = {1: "line2", 2: "quad4", 3: "hexahedron8"}
LINEAR_SIMPLEX = {2: "triangle3", 3: "tetrahedron4"}
CUTS = {2: ((0, 1, 2), (0, 2, 3)), 3: ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))}


def natural_parts(kind, count):
    """Natural coordinates (parts, corners, dim) of the corners of an element cut into count^dim parts of equal natural size"""
    dim = KINDS[kind].dim
    if kind not in SIMPLICES:
        corner = (natural_nodes(LINEAR_BOX[dim]) + 1)/2
        first = np.array(list(product(range(count), repeat=dim)))[:, ::-1]
        return 2*(first[:, None, :] + corner)/count - 1
    parts = []  # the simplex count >= x >= y >= z >= 0 is cut by whole numbers into simplices of that form [Freudenthal 1942]
    for first in product(range(count), repeat=dim):
        for order in permutations(range(dim)):
            path = np.array(first) + np.vstack([np.zeros(dim, int)] + [np.eye(dim, dtype=int)[list(order[:k + 1])].sum(0) for k in range(dim)])
            if (path[:, 0] <= count).all() and (np.diff(path, axis=1) <= 0).all():
                natural = path - np.hstack([path[:, 1:], np.zeros((dim + 1, 1), int)])
                if np.linalg.det(natural[1:] - natural[0]) < 0:
                    natural[[0, 1]] = natural[[1, 0]]
                parts.append(natural/count)
    return np.array(parts)


def parts_of(kind, places, count):
    """Parts of elements with nodes at `places` (elements, nodes, dim): corners (n, corners, dim), content (n,), centroid and half
    lengths (n, dim), element by element; content and centroid are those of the part between its sides, curved ones too"""
    dim = KINDS[kind].dim
    parts = natural_parts(kind, count)
    straight = (LINEAR_SIMPLEX if kind in SIMPLICES else LINEAR_BOX)[dim]
    points, weights = quadrature(kind)
    corners, contents, centroids, halves = [], [], [], []
    for natural in parts:
        xi = shape_values(straight, points) @ natural
        share = np.linalg.det(np.einsum("nk,pnj->pkj", natural, shape_slopes(straight, points)))
        slopes = np.einsum("enk,pnj->epkj", places, shape_slopes(kind, xi))
        weight = np.linalg.det(slopes)*(share*weights)
        content = weight.sum(1)
        x = np.einsum("pn,enk->epk", shape_values(kind, xi), places)
        corners.append(np.einsum("pn,enk->epk", shape_values(kind, natural), places))
        contents.append(content)
        centroids.append(np.einsum("ep,epk->ek", weight, x)/content[:, None])
        if kind in SIMPLICES:
            half = np.ones((len(places), dim))
        else:  # of the box around the parallelogram at the middle
            arms = np.einsum("enk,nj->ekj", places, shape_slopes(kind, natural.mean(0)[None])[0])/count
            half = np.abs(arms).sum(2)
        halves.append(half*(content/np.prod(2*half, axis=1))[:, None]**(1/dim))  # with the content of the part
    return tuple(np.stack(found, 1).reshape(len(places)*len(parts), *found[0].shape[1:]) for found in (corners, contents, centroids, halves))


def cut_boxes(corners):
    """Boxes with `corners` (n, 2^dim, dim) in the order of meshes as simplices, as `parts_of` gives them"""
    dim = corners.shape[2]
    pieces = corners[:, list(CUTS[dim])].reshape(-1, dim + 1, dim)
    content = np.linalg.det(pieces[:, 1:] - pieces[:, :1])/(2 if dim == 2 else 6)
    return pieces, content, pieces.mean(1), np.repeat(0.5*content[:, None]**(1/dim), dim, 1)


def join_corners(corners, distance):
    """The same corners, those nearer to each other than a distance as one place, to the last bit: parts of neighbours share them"""
    flat = corners.reshape(-1, corners.shape[-1])
    first, back, _ = unique_rows(np.round(flat/distance).astype(np.int64))
    return flat[first[back]].reshape(corners.shape)

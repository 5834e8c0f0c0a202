"""Drawing the particles of one frame into matplotlib axes: values, shapes and sizes in units of the data."""
import matplotlib
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from mpl_toolkits.mplot3d import proj3d

from gimp_files import UNITS, GimpError

AXES = ("x", "y", "z")
SYMMETRIC = ("xx", "yy", "zz", "xy", "yz", "zx")  # order of the stress components
FULL = tuple(a + b for a in AXES for b in AXES)  # row by row: xx xy xz yx ...
SHAPE_FIELDS = ("deformation_gradient", "half_length", "volume", "jacobian")  # what shapes are made of, if it is there
TOO_SMALL_TO_OUTLINE = 5000  # particles in all panels; edges of more make a pattern of their own
TOO_MANY_TO_DRAW_AS_LINES = 20000  # particles; more make pdf and svg too large


# ------------------------------------------------------------------------------------------------------ values


def components_of(name, count):
    """Words that --component takes for a field of `count` components"""
    if count == 3:
        return (*AXES, "magnitude")
    if count == 6:
        return (*SYMMETRIC, "von_mises", "mean", "magnitude")
    if count == 9:
        return (*FULL, "determinant", "magnitude")
    return ("value",)


def scalar_of(frame, name, component=None):
    """One number per particle, its label with unit, and whether it has a natural zero in the middle"""
    values = np.asarray(frame.get(name), float)
    count = 1 if values.ndim == 1 else values.shape[1]
    words = components_of(name, count)
    component = component or {1: "value", 3: "magnitude", 6: "von_mises", 9: "determinant"}.get(count, "value")
    if component not in words:
        raise GimpError(f"field '{name}' has no component '{component}'; choose from: {' '.join(words)}")
    signed = name in ("pressure",)
    if component == "value":
        scalar = values if values.ndim == 1 else values[:, 0]
    elif component == "magnitude":
        square = values**2
        scalar = np.sqrt((square[:, :3].sum(1) + 2*square[:, 3:].sum(1)) if count == 6 else square.sum(1))
    elif component == "von_mises":
        scalar = von_mises(values)
    elif component == "mean":
        scalar, signed = values[:, :3].mean(1), True
    elif component == "determinant":
        scalar = np.linalg.det(values.reshape(-1, 3, 3))
    else:
        scalar, signed = values[:, words.index(component)], name != "deformation_gradient" and "position" not in name
    label = name.replace("_", " ")
    label += f" {component.replace('_', ' ')}" if component != "value" else ""
    unit = UNITS.get(name, "")
    return scalar, f"{label} [{unit}]" if unit else label, signed


def von_mises(stress):
    """Von Mises stress from the six components"""
    s = np.asarray(stress, float)
    normal = (s[:, 0] - s[:, 1])**2 + (s[:, 1] - s[:, 2])**2 + (s[:, 2] - s[:, 0])**2
    return np.sqrt(0.5*normal + 3*(s[:, 3:]**2).sum(1))


# ------------------------------------------------------------------------------------------------------ shapes


def reference_half_length(frame, first, setting):
    """Half edges (n, 3) before deformation, or None where the run did not write them

    The field holds what the basis works with: in cpgimp the current half lengths, which follow the deformation by the
    rule that `domain` names; these are taken back. Where they did not change since the first frame, they are as at the start.
    """
    if "half_length" not in frame.fields:
        return None
    half = np.asarray(frame.fields["half_length"], float).reshape(len(frame), -1)
    half = np.hstack([half, np.zeros((len(half), 3 - half.shape[1]))])
    if "deformation_gradient" not in frame.fields or not _has_changed(frame, first, setting):
        return half
    gradient = deformation_of(frame)
    if setting.domain == "diagonal":
        stretch = np.abs(np.einsum("nkk->nk", gradient))
    elif setting.domain == "volume":
        stretch = np.repeat(np.abs(np.linalg.det(gradient))[:, None]**(1/setting.dimension), 3, 1)
    else:
        square, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", gradient, gradient))
        stretch = np.einsum("nik,nk,nik->ni", axes, np.sqrt(np.maximum(square, 0)), axes)
    return half/np.maximum(stretch, 1e-12)


def _has_changed(frame, first, setting):
    """Whether the half lengths follow the deformation: only cpgimp moves them, and then they differ from the first frame"""
    if setting.basis not in ("", "cpgimp") or first is None or "half_length" not in first.fields:
        return False
    # quantiles, since particles may be stored in another order and may have left
    now, then = (np.quantile(np.asarray(f.fields["half_length"], float), (0, 0.25, 0.5, 0.75, 1), axis=0) for f in (frame, first))
    return not np.allclose(now, then, rtol=1e-5, atol=0)


def deformation_of(frame):
    """F of every particle as (n, 3, 3); the identity where the run did not write it"""
    if "deformation_gradient" in frame.fields:
        return np.asarray(frame.fields["deformation_gradient"], float).reshape(-1, 3, 3)
    return np.broadcast_to(np.eye(3), (len(frame), 3, 3))


def half_edges(frame, first, setting):
    """Half edges (n, 3) before deformation: as written, else from the volume, else from the distance between neighbours"""
    half = reference_half_length(frame, first, setting)
    if half is not None:
        return half
    if "volume" in frame.fields:
        volume = np.abs(np.asarray(frame.fields["volume"], float))
        if "deformation_gradient" in frame.fields:
            volume = volume/np.maximum(np.abs(np.linalg.det(deformation_of(frame))), 1e-12)
        half = 0.5*volume**(1/setting.dimension)
    else:
        half = np.full(len(frame), 0.5*neighbour_distance((first or frame).points))
    return np.repeat(half[:, None], 3, 1)


def neighbour_distance(points, sample=300):
    """Median distance of a particle to the next one"""
    if len(points) < 2:
        return 1.0
    chosen = points[np.linspace(0, len(points) - 1, min(sample, len(points))).astype(int)]
    nearest = []
    for point in chosen:
        square = ((points - point)**2).sum(1)
        square[square == 0] = np.inf  # the particle itself
        nearest.append(square.min())
    return float(np.sqrt(np.median(nearest))) if np.isfinite(np.median(nearest)) else 1.0


def outlines(frame, first, setting, shape="square"):
    """Corner points (n, corners, 2) of the particles in the plane: their boxes or the ellipses in them, carried along by F"""
    half = half_edges(frame, first, setting)[:, :2]
    if shape == "ellipse":
        angle = np.linspace(0, 2*np.pi, 20, endpoint=False)
        unit = np.column_stack([np.cos(angle), np.sin(angle)])*2/np.sqrt(np.pi)  # same area as the box
    else:
        unit = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    arms = unit[None, :, :]*half[:, None, :]
    return frame.points[:, None, :2] + np.einsum("nij,ncj->nci", deformation_of(frame)[:, :2, :2], arms)


# ----------------------------------------------------------------------------------------------------- drawing


def draw_2d(axes, frame, values, first, setting, colours, shape="square", panels=1):
    """The particles in the plane; returns what a colour bar needs"""
    polygons = outlines(frame, first, setting, shape)
    plain = panels*len(frame) > TOO_SMALL_TO_OUTLINE or shape == "ellipse"
    # edges in the colour of the face close the hair lines between neighbours
    drawn = PolyCollection(polygons, array=values, edgecolors="face" if plain else (1, 1, 1, 0.35),
                           linewidths=0.3 if plain else 0.15, **colours)
    drawn.set_rasterized(len(frame) > TOO_MANY_TO_DRAW_AS_LINES)
    axes.add_collection(drawn)
    return drawn


def draw_1d(axes, frame, values, first, setting, colour, label):
    """A value over x; the bars are as wide as the particles"""
    order = np.argsort(frame.points[:, 0])
    half = (half_edges(frame, first, setting)[:, 0]*np.abs(deformation_of(frame)[:, 0, 0]))[order]
    x, y = frame.points[order, 0], values[order]
    bars = np.stack([np.column_stack([x - half, y]), np.column_stack([x + half, y])], 1)
    axes.add_collection(LineCollection(bars, colors=[colour], linewidths=1.2))
    axes.plot(x, y, ".", color=colour, markersize=max(1.5, 6 - 0.01*len(x)), label=label)


def draw_3d(axes, frame, values, first, setting, colours):
    """The particles in space as dots of about their size (no hidden surfaces: pyvista draws better ones)"""
    half = float(np.median(half_edges(frame, first, setting)[:, :3].max(1)))
    figure = axes.get_figure()
    middle = np.array([np.mean(limits) for limits in (axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d())])
    ends = middle + np.vstack([np.zeros(3), 2*half*np.eye(3)])
    axes.apply_aspect()
    flat = axes.transData.transform(np.column_stack(proj3d.proj_transform(*ends.T, axes.get_proj())[:2]))
    size = 72/figure.dpi*np.linalg.norm(flat[1:] - flat[0], axis=1).max()
    return axes.scatter(*frame.points.T, c=values, s=(1.15*size)**2, marker="o", linewidths=0,
                        depthshade=False, **colours)


def draw_box(axes, setting):
    """Outline of the grid's box"""
    if len(setting.lower) < 2 or len(setting.upper) < 2:
        return
    (x0, y0), (x1, y1) = setting.lower[:2], setting.upper[:2]
    if setting.dimension == 2:
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color="0.55", linewidth=0.8, zorder=0)
        return
    z0, z1 = setting.lower[2], setting.upper[2]
    for a in (0, 1):
        for b in (0, 1):
            x, y, z = (x0, x1), (y0, y1), (z0, z1)
            for line in (((x0, x1), (y[a],)*2, (z[b],)*2), ((x[a],)*2, (y0, y1), (z[b],)*2), ((x[a],)*2, (y[b],)*2, (z0, z1))):
                axes.plot(*line, color="0.7", linewidth=0.6, zorder=0)


def draw_mesh(axes, edges):
    """Elements of a mesh, under the particles; edges (n, 2, 2) [m]"""
    axes.add_collection(LineCollection(edges, colors="0.75", linewidths=0.5, zorder=0))


def extent_of(shown, first, setting, whole_box):
    """Lower and upper corner (3,) of what the pictures must show: all drawn frames with a margin, or the box"""
    low = np.min([f.points.min(0) for f in shown], axis=0)
    high = np.max([f.points.max(0) for f in shown], axis=0)
    margin = 0.04*(high - low).max() + 1.5*max(float(np.median(half_edges(f, first, setting)[:, 0])) for f in shown)
    if whole_box and len(setting.lower):
        box = [np.append(np.asarray(c, float), np.zeros(3))[:3] for c in (setting.lower, setting.upper)]
        low, high = np.minimum(low, box[0]), np.maximum(high, box[1])
        margin = 0.02*(high - low).max()
    return low - margin, high + margin


def colour_range(values, signed, limits=None):
    """vmin and vmax over all frames; values that change sign are centred on zero"""
    if limits:
        return limits
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    if finite.size == 0:
        raise GimpError("the chosen field holds no finite number")
    low, high = float(finite.min()), float(finite.max())
    if signed and low < 0 < high:
        low, high = -max(-low, high), max(-low, high)
    largest = max(abs(low), abs(high))
    if high - low > 1e-6*largest:
        return low, high
    return low - 0.01*largest - (largest == 0), high + 0.01*largest + (largest == 0)  # constant: do not show round-off


def beyond(values, low, high):
    """Which ends of the colour bar get an arrow, because some value lies beyond them"""
    below, above = (any(np.any(test) for test in tests) for tests in ([v < low for v in values], [v > high for v in values]))
    return {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[below, above]


def colour_map(name, signed, low, high):
    """The map to use: sequential, or diverging about zero"""
    if name and name not in matplotlib.colormaps:
        raise GimpError(f"no colour map '{name}'; try viridis, magma, cividis, turbo, coolwarm")
    return name or ("RdBu_r" if signed and low < 0 < high else "viridis")

"""Three-dimensional pictures with pyvista; importing this fails where pyvista is not installed."""
import numpy as np
import pyvista

import particle_pictures as pictures

try:  # without a display VTK complains on every picture, and then draws it all the same
    from vtkmodules.vtkCommonCore import vtkLogger
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
except ImportError:  # an older VTK has no logger
    pass

SOLID = 60000  # up to so many particles are drawn as deformed boxes, more as shaded dots
FACES = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])


def image(frame, values, first, painter):
    """The frame as an array of pixels"""
    plotter = pyvista.Plotter(off_screen=True, window_size=window_of(painter))
    plotter.set_background("white")
    half = pictures.half_edges(frame, first, painter.setting)
    norm = painter.colours["norm"]
    look = {"cmap": painter.colours["cmap"], "clim": (norm.vmin, norm.vmax), "show_scalar_bar": False,
            "ambient": 0.4, "diffuse": 0.65}
    if len(frame) <= SOLID:
        mesh = boxes(frame, half)
        mesh.cell_data["value"] = np.repeat(values, 6)
        plotter.add_mesh(mesh, scalars="value", smooth_shading=False, **look)
    else:
        mesh = pyvista.PolyData(frame.points)
        mesh.point_data["value"] = values
        pixels = 2*float(np.median(half))*1000/float(np.linalg.norm(painter.high - painter.low))
        plotter.add_mesh(mesh, scalars="value", render_points_as_spheres=True, point_size=max(2.0, 1.3*pixels), **look)
    if painter.arguments.box and len(painter.setting.lower) == 3:
        low, high = painter.setting.lower, painter.setting.upper
        plotter.add_mesh(pyvista.Box([v for pair in zip(low, high) for v in pair]), style="wireframe", color="gray")
    aim(plotter, painter)
    pixels = plotter.screenshot(return_img=True)
    plotter.close()
    return pixels


def boxes(frame, half):
    """One deformed box for each particle"""
    unit = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    arms = unit[None]*half[:, None, :]
    corners = frame.points[:, None] + np.einsum("nij,ncj->nci", pictures.deformation_of(frame), arms)
    faces = FACES[None] + 8*np.arange(len(frame))[:, None, None]
    faces = np.concatenate([np.full((*faces.shape[:2], 1), 4), faces], 2)
    return pyvista.PolyData(corners.reshape(-1, 3), faces.ravel())


def aim(plotter, painter):
    """Look at the extent from the angles of --view, the same way in all frames, and as close as it fits"""
    corners, across, upwards, away = _camera(painter)
    middle = 0.5*(painter.low + painter.high)
    distance = 3*float(np.linalg.norm(painter.high - painter.low))
    plotter.enable_parallel_projection()
    plotter.camera_position = [tuple(middle + distance*away), tuple(middle), tuple(upwards)]
    plotter.camera.parallel_scale = 0.5*float(np.ptp(corners @ upwards))
    plotter.camera.clipping_range = (0.1*distance, 2*distance)


def window_of(painter, longest=1000):
    """Size of the picture in pixels, of the shape of the extent as seen by the camera"""
    corners, across, upwards, _ = _camera(painter)
    size = np.array([np.ptp(corners @ across), np.ptp(corners @ upwards)])
    return tuple(int(n) for n in np.maximum(size/size.max()*longest, 100))


def _camera(painter):
    """Corners of the extent, and the directions to the right, up, and to the eye"""
    up, around = np.radians(painter.arguments.view)
    away = np.array([np.cos(up)*np.cos(around), np.cos(up)*np.sin(around), np.sin(up)])
    across = np.array([-np.sin(around), np.cos(around), 0.0])
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return painter.low + corners*(painter.high - painter.low), across, np.cross(away, across), away

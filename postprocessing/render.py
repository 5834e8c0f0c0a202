#!/usr/bin/env python3
"""Pictures and films of the particles of a run of gimp.x.

  render.py disks.vtkhdf                                     last frame, speed in colour, to disks.png
  render.py disks.vtkhdf --field stress --component xx       a stress component
  render.py disks.vtkhdf --frames 0,5,last                   several times side by side
  render.py disks.vtkhdf --animate disks.gif --fps 20        a film (mp4 needs ffmpeg)

In two dimensions every particle is drawn with its true size; with deformation_gradient and half_length among the fields
of &output also with its deformation. In three dimensions pyvista is used if it is installed, else matplotlib.
"""
import suitable_python  # noqa: F401 isort: skip (must come first)
import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib import animation  # noqa: E402
from matplotlib.cm import ScalarMappable  # noqa: E402
from matplotlib.colors import Normalize  # noqa: E402
from matplotlib.ticker import MaxNLocator, NullFormatter  # noqa: E402

import gimp_files as gf  # noqa: E402
import particle_pictures as pictures  # noqa: E402


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", help="output file of a run, NAME.vtkhdf")
    parser.add_argument("--field", default="velocity", help="what the colour shows (default: velocity)")
    parser.add_argument("--component",
                        help="x y z magnitude; for stress xx yy zz xy yz zx von_mises mean; for a gradient xx xy .. "
                             "determinant")
    parser.add_argument("--frame", "--frames", dest="frames", default=None, metavar="WHICH",
                        help="numbers (-1 is the last), ranges a:b:c, first, last, all; "
                             "several give a strip (default: last, for a film all)")
    parser.add_argument("--output", metavar="FILE", help="picture to write: png, pdf, svg (default: NAME.png)")
    parser.add_argument("--animate", metavar="FILE", help="film to write: gif, or mp4 if ffmpeg is there")
    parser.add_argument("--fps", type=float, default=15, help="frames per second of the film (default: 15)")
    parser.add_argument("--title", help="title (default: that of the scene)")
    parser.add_argument("--shape", choices=("square", "ellipse"), default="square",
                        help="how particles look in 2D (default: square)")
    parser.add_argument("--box", action="store_true", help="show the whole box of the grid, with its outline")
    parser.add_argument("--mesh", metavar="FILE", help="2D: draw the elements of this mesh file under the particles; with --box all of them")
    parser.add_argument("--limits", nargs=2, type=float, metavar=("LOW", "HIGH"),
                        help="range of the colours (default: that of the frames)")
    parser.add_argument("--colormap", metavar="NAME", help="colour map of matplotlib")
    parser.add_argument("--view", nargs=2, type=float, default=(22, -60), metavar=("UP", "AROUND"),
                        help="3D: angles of view, degrees")
    parser.add_argument("--plain", action="store_true", help="3D: use matplotlib even if pyvista is there")
    parser.add_argument("--width", type=float, help="width of the figure, inches")
    parser.add_argument("--dpi", type=float, default=150, help="dots per inch (default: 150)")
    return parser.parse_args(words)


class Painter:
    """Everything that is the same in all frames of one figure or film"""

    def __init__(self, arguments, frame_numbers):
        self.arguments = arguments
        self.setting = gf.setting(arguments.file)
        self.edges = None
        if arguments.mesh:
            if self.setting.dimension != 2:
                raise gf.GimpError("--mesh: elements are drawn in two dimensions only")
            self.edges = gf.mesh_edges(arguments.mesh)
            self.setting.lower, self.setting.upper = self.edges.min((0, 1)), self.edges.max((0, 1))
        needed = (arguments.field, *pictures.SHAPE_FIELDS)
        self.first = next(gf.frames(arguments.file, "0", needed))
        self.frames = list(gf.frames(arguments.file, ",".join(map(str, frame_numbers)), needed))
        scalars = [pictures.scalar_of(f, arguments.field, arguments.component) for f in self.frames]
        self.values = [s[0] for s in scalars]
        _, self.label, self.signed = scalars[0]
        limits = pictures.colour_range(self.values, self.signed, arguments.limits)
        name = pictures.colour_map(arguments.colormap, self.signed, *limits)
        self.colours = {"cmap": matplotlib.colormaps[name], "norm": Normalize(*limits)}
        self.beyond = pictures.beyond(self.values, *limits)
        self.low, self.high = pictures.extent_of(self.frames, self.first, self.setting, arguments.box)
        self.title = self.setting.title if arguments.title is None else arguments.title
        self.screen = None
        if self.setting.dimension == 3 and not arguments.plain:
            self.screen = space_painter()

    def time_label(self, frame):
        return f"t = {frame.time:.4g} s"

    def panels(self, count):
        """A figure with `count` panels in rows and one colour bar for all"""
        span = np.maximum(self.high - self.low, 1e-12)
        shape = 1.0 if self.setting.dimension == 3 else float(np.clip(span[1]/span[0], 0.15, 4))
        columns = min(count, 5 if shape > 0.6 else 3)
        rows = -(-count//columns)
        width = self.arguments.width or {1: 6.4, 2: 9.0}.get(columns, min(3.3*columns, 15) + 0.8)
        panel = (width - 1.0)/columns
        while columns == 1 and panel*shape > 7.5 and not self.arguments.width:
            width *= 0.85
            panel = width - 1.4
        height = rows*(panel*shape + 0.55) + (0.5 if self.title else 0.2)
        projection = "3d" if self.setting.dimension == 3 and self.screen is None else None
        figure = plt.figure(figsize=(width, height), layout=None if projection else "constrained")
        axes = figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": projection}).ravel()
        for spare in axes[count:]:
            spare.set_axis_off()
        if self.title:
            figure.suptitle(self.title, fontsize=12)
        place = {"ax": list(axes), "shrink": 0.9, "pad": 0.02, "aspect": max(12, 24*min(1, rows*shape))}
        if projection:  # axes in space have labels that the layout engine cannot place
            figure.subplots_adjust(left=0.01, right=1 - (1.75 if count == 1 else 1.35)/width, bottom=0.05,
                                   top=1 - 0.6/height, wspace=0.05, hspace=0.15)
            place = {"cax": figure.add_axes([1 - 1.05/width, 0.18, 0.16/width, 0.6])}
        bar = figure.colorbar(ScalarMappable(**self.colours), label=self.label, extend=self.beyond, **place)
        bar.formatter.set_useOffset(False)
        bar.formatter.set_powerlimits((-3, 4))  # not "800000"
        bar.update_ticks()
        return figure, axes[:count]

    def paint(self, axes, number, outer=True):
        """Draw frame `number` of the chosen ones"""
        frame, values = self.frames[number], self.values[number]
        axes.set_title(self.time_label(frame), fontsize=10)
        if self.setting.dimension == 2:
            pictures.draw_2d(axes, frame, values, self.first, self.setting, self.colours, self.arguments.shape,
                             1 if self.arguments.animate else len(self.frames))
            axes.set(xlim=(self.low[0], self.high[0]), ylim=(self.low[1], self.high[1]), aspect="equal", xlabel="x [m]")
            axes.set_ylabel("y [m]" if outer else "")
            axes.tick_params(labelleft=outer, labelsize=8)
            if self.edges is not None:
                pictures.draw_mesh(axes, self.edges)
            elif self.arguments.box:
                pictures.draw_box(axes, self.setting)
        elif self.screen:
            image = self.screen(frame, values, self.first, self)
            axes.imshow(image)
            axes.set_axis_off()
        else:
            axes.set(xlim=(self.low[0], self.high[0]), ylim=(self.low[1], self.high[1]), zlim=(self.low[2], self.high[2]))
            span = self.high - self.low
            for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), span/span.max()):
                axis.set_major_locator(MaxNLocator(max(2, int(6*share))))
            if len(self.frames) > 1 and not self.arguments.animate:  # small panels: numbers would overlap
                for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
                    axis.set_major_formatter(NullFormatter())
            else:
                axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
            axes.set_box_aspect(self.high - self.low)
            axes.view_init(*self.arguments.view)
            axes.tick_params(labelsize=7)
            pictures.draw_3d(axes, frame, values, self.first, self.setting, self.colours)
            if self.arguments.box:
                pictures.draw_box(axes, self.setting)

    def figure(self):
        """All chosen frames in one figure"""
        if self.setting.dimension == 1:
            return self.curves(range(len(self.frames)))
        figure, axes = self.panels(len(self.frames))
        columns = axes[0].get_subplotspec().get_gridspec().ncols
        for number, panel in enumerate(axes):
            self.paint(panel, number, outer=number % columns == 0)
        return figure

    def curves(self, numbers):
        """One dimension: the value over x, one colour for each time"""
        figure, axes = plt.subplots(figsize=(self.arguments.width or 6.4, 4.0), layout="constrained")
        for number in numbers:
            colour = plt.cm.viridis(0.9*number/max(1, len(self.frames) - 1))
            pictures.draw_1d(axes, self.frames[number], self.values[number], self.first, self.setting, colour,
                             self.time_label(self.frames[number]))
        norm = self.colours["norm"]
        margin = 0.05*(norm.vmax - norm.vmin)
        axes.set(xlim=(self.low[0], self.high[0]), ylim=(norm.vmin - margin, norm.vmax + margin), xlabel="x [m]",
                 ylabel=self.label)
        axes.grid(True, color="0.9")
        if len(list(numbers)) <= 4:
            axes.legend(loc="best", fontsize=8)
        elif len(list(numbers)) <= 16:  # beside the curves, which so many entries would cover
            axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=8, frameon=False)
        axes.set_title(self.title, fontsize=12)
        return figure


def space_painter():
    """The 3D painter of pyvista, or None where pyvista is not installed"""
    try:
        import space_pictures as space
        return space.image
    except ImportError:
        gf.say("pyvista is not installed: drawing with matplotlib (pip install pyvista gives shaded pictures)")
        return None


def film(painter, path, fps):
    """Write all chosen frames as a film"""
    kind = Path(path).suffix.lower()
    if kind not in (".gif", ".mp4"):
        raise gf.GimpError(f"--animate {path}: the name must end in .gif or .mp4")
    if kind == ".mp4" and not animation.writers.is_available("ffmpeg"):
        raise gf.GimpError(f"--animate {path}: mp4 needs the program ffmpeg, which is not there; write a .gif")
    writer = (animation.FFMpegWriter if kind == ".mp4" else animation.PillowWriter)(fps=fps)
    if painter.setting.dimension == 1:
        figure, axes = painter.curves([0]), None
    else:
        figure, (axes,) = painter.panels(1)
    with writer.saving(figure, path, painter.arguments.dpi):
        for number in range(len(painter.frames)):
            if axes is None:
                figure.clear()
                panel = figure.add_subplot()
                pictures.draw_1d(panel, painter.frames[number], painter.values[number], painter.first, painter.setting, "C0", None)
                norm = painter.colours["norm"]
                panel.set(xlim=(painter.low[0], painter.high[0]), ylim=(norm.vmin, norm.vmax), xlabel="x [m]",
                          ylabel=painter.label, title=painter.time_label(painter.frames[number]))
            else:
                axes.clear()
                painter.paint(axes, number)
            writer.grab_frame()
            gf.say(f"frame {number + 1} of {len(painter.frames)}")
    plt.close(figure)


def main(words=None):
    arguments = parse_arguments(words)
    count = len(gf.frame_times(arguments.file))
    chosen = gf.select_frames(arguments.frames or ("all" if arguments.animate else "last"), count)
    if not arguments.animate and len(chosen) > 30:
        raise gf.GimpError(f"{len(chosen)} frames do not fit in one picture; choose fewer, or write a film with --animate")
    painter = Painter(arguments, chosen)
    if arguments.animate:
        film(painter, arguments.animate, arguments.fps)
        print(arguments.animate)
    if arguments.output or not arguments.animate:
        target = arguments.output or str(Path(arguments.file).with_suffix(".png"))
        figure = painter.figure()
        try:
            figure.savefig(target, dpi=arguments.dpi)
        except (OSError, ValueError) as problem:
            raise gf.GimpError(f"{target}: cannot be written ({problem})") from None
        plt.close(figure)
        print(target)
    return 0


if __name__ == "__main__":
    gf.run_main(main)

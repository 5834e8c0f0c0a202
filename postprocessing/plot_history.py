#!/usr/bin/env python3
"""Energies, energy books and step size of a run of gimp.x over time.

  plot_history.py disks.vtkhdf                           to disks.history.png
  plot_history.py disks.vtkhdf --momentum                with momentum and angular momentum
  plot_history.py disks.vtkhdf --columns probe1_x        any columns of the history; --list names them
"""
import suitable_python  # noqa: F401 isort: skip (must come first)
import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import gimp_files as gf  # noqa: E402

ENERGIES = (("kinetic_energy", "kinetic", "C0", "-"), ("stored_energy", "stored", "C1", "-"),
            ("dissipated", "dissipated", "C3", "-"), ("external_work", "work of the loads", "C2", "--"),
            ("reaction_work", "work of the sides", "C4", "--"), ("transfer_loss", "lost in transfer", "C5", ":"),
            ("stress_update_error", "stress-update error", "C6", ":"), ("total", "total", "k", "-"))
DISSIPATION = ("plastic_dissipation", "damping_dissipation", "removed_energy")
ALWAYS = ("kinetic_energy", "stored_energy", "total")


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", help="output file of a run, NAME.vtkhdf")
    parser.add_argument("--momentum", action="store_true", help="also draw momentum and angular momentum")
    parser.add_argument("--columns", help="draw these columns of the history instead, comma between")
    parser.add_argument("--list", action="store_true", help="print first, least, largest and last value of each column, draw nothing")
    parser.add_argument("--output", metavar="FILE", help="picture to write (default: NAME.history.png)")
    parser.add_argument("--title", help="title (default: that of the scene)")
    parser.add_argument("--dpi", type=float, default=150, help="dots per inch (default: 150)")
    return parser.parse_args(words)


def energy_curves(table):
    """Energies and works over time, by name; total = kinetic + stored + dissipated, as in energy_drift

    What the method loses in the transfer, and what its stress update gains or loses, belong to no physical book: they are
    curves of their own, and their sum is the drift. Curves that stay at zero are left out.
    """
    curves = {name: table[name] for name in ("kinetic_energy", "stored_energy", "external_work", "reaction_work",
                                             "stress_update_error") if name in table}
    curves["dissipated"] = sum((table[name] for name in DISSIPATION if name in table), 0*table["time"])
    curves["transfer_loss"] = table.get("transfer_loss_p2g", 0*table["time"]) + table.get("transfer_loss_g2p", 0)
    curves["total"] = curves.get("kinetic_energy", 0) + curves.get("stored_energy", 0) + curves["dissipated"]
    largest = max(np.abs(c).max(initial=0) for c in curves.values())
    least = {"transfer_loss": 1e-2, "stress_update_error": 1e-2}  # smaller ones are a line on the axis
    return {name: c for name, c in curves.items() if name in ALWAYS or np.abs(c).max(initial=0) > least.get(name, 1e-9)*largest}


def is_flywheel(curves):
    """Whether a kinetic energy that hardly changes would press all other curves onto the axis"""
    kinetic = curves["kinetic_energy"]
    others = max(np.abs(c).max(initial=0) for name, c in curves.items() if name not in ("kinetic_energy", "total"))
    return max(np.ptp(kinetic), others) < 0.02*np.abs(kinetic).max(initial=0)


def draw_energies(axes, table):
    curves = energy_curves(table)
    less = " less start" if "kinetic_energy" in curves and is_flywheel(curves) else ""
    for name, label, colour, line in ENERGIES:
        if name in curves:
            moved = less and name in ("kinetic_energy", "total")
            axes.plot(table["time"], curves[name] - (curves["kinetic_energy"][0] if moved else 0), line,
                      color=colour, label=label + (less if moved else ""), linewidth=1.6 if name == "total" else 1.2)
    axes.set_ylabel("energy [J]")
    axes.margins(y=0.12)
    axes.legend(fontsize=8, ncols=3)


def draw_residuals(axes, table, units):
    drawn = False
    for name, label in (("energy_residual", "residual of the books"), ("energy_drift", "drift")):
        if name not in table:
            continue
        size = np.abs(table[name])
        size = np.where(size > 0, size, np.nan)  # an exact zero has no place on a log axis
        unit = f" [{units[name]}]" if units.get(name, "").strip() not in ("", "1", "-") else ""
        axes.semilogy(table["time"], size, label=f"|energy {label}|{unit}", linewidth=1.0)
        drawn = drawn or np.isfinite(size).any()
    if not drawn:
        axes.text(0.5, 0.5, "residual and drift are zero throughout", transform=axes.transAxes, ha="center", color="0.4")
    axes.set_ylabel("energy error")
    axes.legend(fontsize=8) if drawn else None


def draw_step(axes, table):
    axes.plot(table["time"][1:], table["dt"][1:], drawstyle="steps-pre", color="C7", linewidth=1.2)
    axes.set_ylim(0, 1.15*np.max(table["dt"][1:], initial=0) or 1)
    axes.set_ylabel("time step [s]")


def draw_vector(axes, table, stem, label):
    for axis in "xyz":
        values = table.get(f"{stem}_{axis}")
        if values is not None and np.any(values != 0):
            axes.plot(table["time"], values, label=axis, linewidth=1.2, color="C" + str("xyz".index(axis)))
    axes.set_ylabel(label)
    if axes.lines:
        axes.legend(fontsize=8, ncols=3)
    else:
        axes.text(0.5, 0.5, "zero throughout", transform=axes.transAxes, ha="center", color="0.4")


def draw_column(axes, table, units, name):
    if name not in table:
        raise gf.GimpError(f"the history has no column '{name}'; it has: {' '.join(table)}")
    axes.plot(table["time"], table[name], linewidth=1.2)
    axes.set_ylabel(f"{name.replace('_', ' ')} [{units[name]}]" if units.get(name) else name.replace("_", " "))


def figure_of(table, units, title="", momentum=False, columns=()):
    """The figure for one history"""
    if columns:
        drawings = [(1.0, lambda axes, name=name: draw_column(axes, table, units, name)) for name in columns]
    else:
        drawings = [(1.8, lambda axes: draw_energies(axes, table)),
                    (1.0, lambda axes: draw_residuals(axes, table, units)),
                    (0.7, lambda axes: draw_step(axes, table))]
        if momentum:
            drawings += [(1.0, lambda axes: draw_vector(axes, table, "momentum", "momentum [kg m/s]")),
                         (1.0, lambda axes: draw_vector(axes, table, "angular_momentum", "ang. momentum [kg m2/s]"))]
    heights = [height for height, _ in drawings]
    figure, panels = plt.subplots(len(drawings), 1, sharex=True, squeeze=False, layout="constrained",
                                  figsize=(7.0, 0.8 + 1.75*sum(heights)), height_ratios=heights)
    for (_, draw), axes in zip(drawings, panels[:, 0]):
        draw(axes)
        axes.grid(True, color="0.92")
        axes.tick_params(labelsize=8)
    panels[-1, 0].set_xlabel("time [s]")
    figure.suptitle(title, fontsize=12)
    return figure


def main(words=None):
    arguments = parse_arguments(words)
    table, units = gf.history(arguments.file), gf.history_units(arguments.file)
    if "time" not in table or len(table["time"]) == 0:
        raise gf.GimpError(f"{arguments.file}: the history has no complete row yet")
    if arguments.list:
        print(f"{'column':28s} {'unit':8s} {'first':>13s} {'least':>13s} {'at t [s]':>10s} {'largest':>13s} {'at t [s]':>10s} "
              f"{'last':>13s}")
        for name, values in table.items():
            low, high = table["time"][np.argmin(values)], table["time"][np.argmax(values)]
            print(f"{name:28s} {units.get(name, ''):8s} {values[0]:13.6g} {np.min(values):13.6g} {low:10.4g} "
                  f"{np.max(values):13.6g} {high:10.4g} {values[-1]:13.6g}")
        return 0
    columns = [w.strip() for w in arguments.columns.split(",")] if arguments.columns else ()
    title = arguments.title if arguments.title is not None else gf.setting(arguments.file).title
    figure = figure_of(table, units, title, arguments.momentum, columns)
    target = arguments.output or str(Path(arguments.file).with_suffix(".history.png"))
    try:
        figure.savefig(target, dpi=arguments.dpi)
    except (OSError, ValueError) as problem:
        raise gf.GimpError(f"{target}: cannot be written ({problem})") from None
    plt.close(figure)
    print(target)
    return 0


if __name__ == "__main__":
    gf.run_main(main)

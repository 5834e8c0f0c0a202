"""What work_precision.py shows of its rows: lines of a method over its grids, the Pareto front, tables and the figure."""
import csv
import math
import re
import textwrap
from dataclasses import dataclass, field

import gimp_files as gf
from convergence import rate
from work_precision_runs import number_of

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f3c8d", "#4d4d4d", "#a6761d", "#66a61e", "#e31a1c",
           "#1b9e77", "#b8860b", "#000080", "#8b0000", "#20b2aa")
MARKS = "osD^vP*Xph<>d8H."
LINES = ("-", "--", ":", "-.")
ROUND_OFF = 1e-10  # smaller errors are no business of a method; an axis down to 1e-15 would show nothing else
WILD = 2.0  # times the scale: such a run ended without complaint and is no solution
WORK = "particle_steps"
AXES = {"core_seconds": "core-seconds of stepping (wall clock times threads) [s]", WORK: "particle-steps (particles × steps)",
        "processor_seconds": "processor time of the whole run [s]"}
SHORT = {"core_seconds": "core-s", "processor_seconds": "proc.-s"}


@dataclass
class Line:
    """A method at one Courant number and precision, over its grids from coarse to fine"""
    label: str
    group: str
    courant: str
    precision: str
    rows: list = field(default_factory=list)
    colour: str = "k"
    mark: str = "o"
    dashes: str = "-"
    name: str = ""

    def points(self, cost, measure):
        """Cost and error of the runs that have both"""
        found = [(number_of(row, cost), number_of(row, measure)) for row in self.rows if problem_of(row, measure) is None]
        return [(c, e) for c, e in found if c > 0 and math.isfinite(e)]


def problem_of(row, measure):
    """Why a run has no point: its state and reason; None if it has one"""
    if row["state"] != "done":
        return f"{row['state']}: {row['reason']}" if row.get("reason") else row["state"]
    if not math.isfinite(number_of(row, measure)):
        return f"ended without complaint, but its {measure} is no number"
    return None


def lines_of(rows):
    """The rows as lines, in the order of the methods"""
    found = {}
    for row in rows:
        key = (row["label"], row.get("courant", ""), row["precision"])
        found.setdefault(key, Line(row["label"], row.get("group", ""), key[1], key[2])).rows.append(row)
    lines = list(found.values())
    labels, courants, groups = [], [], {}
    for line in lines:
        line.rows.sort(key=lambda row: -row["h"])
        mates = groups.setdefault(line.group, [])
        if line.label not in mates:
            mates.append(line.label)
        if line.courant not in courants:
            courants.append(line.courant)
        labels.append(line.label)
        line.colour = COLOURS[mates.index(line.label) % len(COLOURS)]
        line.mark = MARKS[mates.index(line.label) % len(MARKS)]
        line.dashes = LINES[courants.index(line.courant) % len(LINES)] if labels.count(line.label) > 1 else "-"
    for line in lines:
        mates = [mate for mate in lines if mate.label == line.label]
        line.name = (line.label + (f", Courant {line.courant}" if len({mate.courant for mate in mates}) > 1 else "")
                     + (f", {line.precision}" if len({mate.precision for mate in mates}) > 1 else ""))
    return lines


def slope(points):
    """Exponent of error over cost: the straight line of least squares through the logarithms; nan with fewer than two"""
    logs = [(math.log(c), math.log(e)) for c, e in points if e > 0]
    if len(logs) < 2:
        return math.nan
    x, y = (sum(column)/len(logs) for column in zip(*logs))
    spread = sum((a - x)**2 for a, _ in logs)
    return sum((a - x)*(b - y) for a, b in logs)/spread if spread > 0 else math.nan


def pareto(points):
    """The points that none beats in both cost and error, from cheap to dear"""
    front = []
    for cost, error in sorted(points):
        if not front or error < front[-1][1]:
            front.append((cost, error))
    return front


def rates(line, measure):
    """Order between each grid of a line and the one before, in spacing; None for the first, nan where a run has no error"""
    points = [{"h": row["h"], "error": number_of(row, measure) if problem_of(row, measure) is None else math.nan} for row in line.rows]
    return [None] + [rate(a, b, "error") for a, b in zip(points, points[1:])]


# ---------------------------------------------------------------------------------------------------- tables


def read_expected(path):
    """(label, cells) -> what another program or a paper found"""
    with open(path, newline="") as file:
        return {(row["scene"], row["measure"], row["label"], row["cells"]): float(row["expected"]) for row in csv.DictReader(file)}


def shown(value, form):
    return format(value, form) if isinstance(value, (int, float)) and math.isfinite(value) else "-"


def table(lines, measure, cost="core_seconds", expected=None):
    """Rows of text, one for a line: errors over the grids, last rate, slopes, speed, cost of the finest run; and what was expected"""
    cells = sorted({int(row["cells"]) for line in lines for row in line.rows})
    heading = ["method", *(f"{n} cells" for n in cells), "last rate", f"slope, {SHORT[cost]}", "slope, p-steps", "ns/p-step",
               f"{SHORT[cost]}, finest"]
    out = [heading]
    for line in lines:
        by_cells = {int(row["cells"]): row for row in line.rows}
        errors = []
        for n in cells:
            row = by_cells.get(n)
            problem = problem_of(row, measure) if row else "-"
            errors.append(problem.split(":")[0].split(",")[0] if problem else f"{number_of(row, measure):.3e}")
        timed = [row for row in line.rows if number_of(row, cost) > 0 and number_of(row, WORK) > 0]
        finest = timed[-1] if timed else {}  # a run that failed has a speed, but not the cost of a whole run
        order = [r for r in rates(line, measure) if r is not None and math.isfinite(r)]
        out.append([line.name, *errors, shown(order[-1] if order else None, ".2f"),
                    *(shown(slope(line.points(c, measure)), ".2f") for c in (cost, WORK)),
                    shown(1e9*finest[cost]/finest[WORK] if finest else None, ".0f"),
                    shown(finest.get(cost) if finest.get("state") == "done" else None, ".3g")])
        out += expected_row(line, cells, measure, expected)
    return out


def compared(line, measure, expected):
    """(cells, expected, found) of the grids of a line for which a number is known; of a loss, what is kept. Found is nan if the run failed"""
    kept = measure.replace("_loss", "_kept")
    pairs = [(row, expected.get((row["scene"], kept, line.label, row["cells"]))) for row in line.rows]
    return [(int(row["cells"]), known, number_of(row, kept) if row["state"] == "done" else math.nan) for row, known in pairs if known]


def expected_row(line, cells, measure, expected):
    """What was expected of a line and how near it comes, as a list of one row or none"""
    known = compared(line, measure, expected or {})
    if not known:
        return []
    ratios = [found/number for _, number, found in known if math.isfinite(found)]
    told = f"ratio {min(ratios):.3f} to {max(ratios):.3f}" if ratios else "-"
    words, by_cells = " to be kept" if measure.endswith("_loss") else "", {n: f"{number:.4g}" for n, number, _ in known}
    return [[f"*expected{words}* ({told})", *(by_cells.get(n, "") for n in cells), "", "", "", "", ""]]


def verdict(lines, measure, expected, tolerance=0.05):
    """How many numbers were expected, how near the runs come, and which are not within the tolerance"""
    known = [(line.name, n, number, found) for line in lines for n, number, found in compared(line, measure, expected)
             if line.rows[0]["state"] != "not in this build"]
    ratios = [found/number for _, _, number, found in known if math.isfinite(found)]
    off = [f"{name}, {n} cells: {found:.4g} for {number:.4g}" for name, n, number, found in known if not abs(found/number - 1) <= tolerance]
    span = f", ratios {min(ratios):.3f} to {max(ratios):.3f}" if ratios else ""
    return f"{len(known)} numbers expected{span}; {len(known) - len(off)} within {100*tolerance:g} %" + "".join("\n  off: " + o for o in off)


def plain(rows):
    """A table for the terminal"""
    width = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join("  ".join(cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, width))).rstrip() for row in rows)


def markdown(rows):
    """A table for a document"""
    return "\n".join("| " + " | ".join(row) + " |" for row in (rows[0], ["---"] + ["---:"]*(len(rows[0]) - 1), *rows[1:]))


def failures(lines, measure):
    """What has no point, or a wild one, and why; one text for all methods that the build does not have"""
    missing, found = [], {}
    for line in lines:
        for row in line.rows:
            problem = problem_of(row, measure)
            if problem and row["state"] == "not in this build":
                missing += [line.name] if line.name not in missing else []
            elif not problem and number_of(row, measure) > WILD and (measure in ("error_rms", "error_max") or measure.endswith("_loss")):
                found.setdefault((line.name, f"exit code 0, but {measure} = {number_of(row, measure):.3g}"), []).append(row["cells"])
            elif problem:
                found.setdefault((line.name, brief(problem)), []).append(row["cells"])
    texts = [f"{name}, {', '.join(cells)} cells: {problem}" for (name, problem), cells in found.items()]
    return texts + ([f"not in this build: {', '.join(missing)}"] if missing else [])


def brief(problem):
    """The complaint of a run without step number, place and step size; the CSV file has it in full"""
    problem = re.sub(r"step \d+, t = (\S+) s, dt = \S+ s: ", lambda hit: f"t = {float(hit.group(1)):.3g} s: ", problem)
    return re.sub(r"particle \d+ at [^:]*: its", "a particle: its", problem)


# ---------------------------------------------------------------------------------------------------- figure


def draw(lines, measure, path, title, seconds="core_seconds"):
    """Two panels for each group of methods: error over seconds and over particle-steps; axes are the same for all groups"""
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    groups = [g for g in dict.fromkeys(line.group for line in lines)
              if any(line.points(WORK, measure) for line in lines if line.group == g)] or [""]
    told = [part for text in failures(lines, measure) for part in textwrap.wrap(text, 200, subsequent_indent="      ")]
    heights = [max(3.0, 0.19*sum(line.group == g for line in lines) + 0.6) for g in groups]
    figure, panels = plt.subplots(len(groups), 2, squeeze=False, sharex="col", sharey=True, layout="constrained", height_ratios=heights,
                                  figsize=(12.5, 0.9 + sum(heights) + 0.145*len(told)))
    for column, cost in enumerate((seconds, WORK)):
        everything = [p for line in lines for p in line.points(cost, measure) if p[1] > 0]
        for group, axes in zip(groups, panels[:, column]):
            mates = [line for line in lines if line.group == group]
            draw_panel(axes, mates, cost, seconds, measure, pareto(everything))
            axes.set_title(group, fontsize=10, loc="left")
        panels[-1, column].set_xlabel(AXES[cost])
        if not everything:
            panels[0, column].text(0.5, 0.5, "not timed: runs were side by side" if cost == seconds else "no run has an error",
                                   transform=panels[0, column].transAxes, ha="center", color="0.4")
    shown_errors = [e for line in lines for _, e in line.points(WORK, measure) if e >= ROUND_OFF]
    if shown_errors:
        spread = max(shown_errors)/min(shown_errors)
        panels[0, 0].set_ylim(min(shown_errors)/(1.2*spread**0.06), max(shown_errors)*1.2*spread**0.1)  # room for the marks at the edges
    for axes in panels[:, 0]:
        axes.set_ylabel(axis_label(lines, measure))
    for axes in panels[:, 1]:
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=7.5, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, alignment="left",
                        title="(slope over seconds | particle-steps)", title_fontsize=7.5)
    cells = sorted({int(row["cells"]) for line in lines for row in line.rows})
    figure.suptitle(f"{title}\n", fontsize=12)
    figure.text(0.5, 1 - 0.42/figure.get_figheight(), f"points of a line: {', '.join(map(str, cells))} cells along x; grey: Pareto "
                "front of all methods here; ×, at the top: failed run, at the work it had done", ha="center", fontsize=8.5, color="0.3")
    if told:
        figure.supxlabel("\n".join(["Runs without a point, or with a wild one:", *told]), fontsize=7, x=0.01, ha="left", color="0.25")
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as problem:
        raise gf.GimpError(f"{path}: cannot be written ({problem})") from None
    plt.close(figure)


def draw_panel(axes, lines, cost, seconds, measure, front):
    """One group of methods over one cost"""
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator
    axes.set_xscale("log")
    axes.set_yscale("log")
    if front:
        axes.plot(*zip(*front), color="0.85", linewidth=5, drawstyle="steps-post", solid_capstyle="round", solid_joinstyle="round", zorder=1)
    for line in lines:
        points = line.points(cost, measure)
        slopes = [slope(line.points(c, measure)) for c in (seconds, WORK)]
        label = f"{line.name}  ({shown(slopes[0], '.2f')} | {shown(slopes[1], '.2f')})"
        face = "white" if line.precision == "single" else line.colour
        above = [(c, e) for c, e in points if e >= ROUND_OFF]
        for c, _ in set(points) - set(above):  # exact to round-off: on the lower edge, which stands for anything below
            axes.plot(c, 0.02, marker=line.mark, color=line.colour, markerfacecolor=face, markersize=5.5, clip_on=False,
                      transform=axes.get_xaxis_transform(), zorder=4)
        if points and not above:
            axes.plot([], [], marker=line.mark, color=line.colour, linestyle="", label=f"{line.name}  (exact to round-off: lower edge)")
        elif above:
            axes.plot(*zip(*above), marker=line.mark, linestyle=line.dashes, color=line.colour, markerfacecolor=face, markersize=5.5,
                      linewidth=1.2, label=label, zorder=3)
        else:
            axes.plot([], [], marker=line.mark, color=line.colour, linestyle="", label=f"{line.name}  (no run has a point)")
        for row in line.rows:
            if row["state"] == "failed" and number_of(row, cost) > 0:
                axes.plot(number_of(row, cost), 0.97, "x", color=line.colour, markersize=6, markeredgewidth=1.6,
                          transform=axes.get_xaxis_transform(), zorder=4)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(LogLocator(subs=(2, 5)))
        axis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(1.6, 1.6)))  # numbers also where an axis spans little
    axes.grid(True, which="major", color="0.9")
    axes.tick_params(labelsize=8, which="both")


def axis_label(lines, measure):
    """What the error is, and in units of what"""
    scales = {str(row["error_scale_by"]) for line in lines for row in line.rows if row.get("error_scale_by")}
    kept = measure.removesuffix("_loss").replace("_", " ")
    if measure in ("error_rms", "error_max"):
        words = {"error_rms": "rms", "error_max": "largest"}[measure]
        return f"displacement error, {words}" + (f",\nin units of {scales.pop()}" if len(scales) == 1 else "")
    units = {"error_rms_velocity": "velocity error, rms [m/s]", "error_rms_stress": "stress error, rms [Pa]"}
    return units.get(measure, f"{kept}: |1 - end/start|" if measure.endswith("_loss") else f"|{kept}|")


def shorten(text, most):
    return text if len(text) <= most else text[:most - 1] + "…"

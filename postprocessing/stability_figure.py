"""What stability.py shows of its rows: the tables in Markdown and the picture of the survival table."""
import math

import gimp_files as gf
import stability_runs as st

COLOURS = {"good": "#1a9850", "fair": "#a6d96a", "poor": "#fee08b", "warned": "#fdae61", "fails": "#9ecae1", "refused": "#d0d0d0", "defect": "#d73027",
           "none": "#ffffff"}
MEANING = {"good": "survives, error up to 0.1 scale", "fair": "survives, up to 1", "poor": "survives, up to 10",
           "warned": "ends, wrong by more, and warns",
           "fails": "fails, says why (× share of time reached)", "refused": "refused", "defect": "silent failure, crash or hang",
           "none": "not in this build, or not run"}
LIGHT = (COLOURS["good"], COLOURS["defect"])  # behind these, text is white


def kind(row):
    """Which colour a row has"""
    if row is None or row["verdict"] == "not in this build":
        return "none"
    if row["verdict"] in st.DEFECTS:
        return "defect"
    if row["verdict"] in ("warned", "fails", "refused"):
        return row["verdict"]
    error = row.get("error", 0.0)
    return "good" if error <= 0.1 else "fair" if error <= 1.0 else "poor"


def short(row):
    """What stands in a cell of the survival table"""
    if row is None or row["verdict"] == "not in this build":
        return "" if row is None else "-"
    if row["verdict"] == "survives":
        return number(row["error"]) if "error" in row else "yes"
    if row["verdict"] == "fails":
        return f"fails {row['reached']:.2f}" if "reached" in row else "fails"
    return f"{row['verdict']} {number(row['error'])}" if "error" in row else row["verdict"]


def number(value):
    """A number in few signs"""
    if not math.isfinite(value):
        return "nan"
    if value == 0 or value < 1e-9:
        return "0"
    return f"{value:.2g}" if 0.01 <= value < 1000 else f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")


def courant(row):
    """What stands in a cell of the Courant numbers"""
    if row is None or "limit" not in row:
        return "" if row is None else "-" if row["verdict"] == "not in this build" else row["verdict"]
    limit = "none" if row["limit"] == 0 else f"> {row['limit']:.2f}" if row["limit"] >= st.LARGEST else f"{row['limit']:.2f}"
    return limit if row["verdict"] == "found" else f"{limit} ({row['verdict']})"


def gain(row):
    """What stands in a cell of the gains of energy"""
    return number(max(0.0, row["energy_gain"])) if row is not None and "energy_gain" in row else ""


def words(row):
    """A row in a line of progress"""
    told = courant(row) if row["kind"] == "courant" else short(row)
    return f"{told}{', ' + row['reason'][:120] if row.get('reason') else ''}"


class Grid:
    """Rows by method and case, in the order in which they come"""

    def __init__(self, rows, kind_of_row):
        rows = [row for row in rows if row["kind"] == kind_of_row]
        self.methods = list(dict.fromkeys((row.get("group", ""), row["label"]) for row in rows))
        self.cases = list(dict.fromkeys(row["case"] for row in rows))
        self.cell = {(row.get("group", ""), row["label"], row["case"]): row for row in rows}

    def row(self, method, case):
        return self.cell.get((*method, case))


def markdown(rows):
    """Courant numbers, survival with errors, gains of energy, and the messages of those that failed"""
    text = []
    grid = Grid(rows, "courant")
    if grid.cases:
        text += ["## Largest stable Courant number", "", *table(grid, courant)]
    grid = Grid(rows, "case")
    if grid.cases:
        text += ["## Survival: error in scales of the case", "", *table(grid, short)]
        text += ["## Gain of energy, of the energy of the case", "", *table(grid, gain)]
        text += ["## What the failures say", "", *messages([row for row in rows if row["kind"] == "case"])]
    return "\n".join(text)


def table(grid, form):
    lines = ["| method | " + " | ".join(case.replace("_", " ") for case in grid.cases) + " |", "|---"*(len(grid.cases) + 1) + "|"]
    group = ""
    for method in grid.methods:
        if method[0] != group:
            group = method[0]
            lines.append(f"| **{group}** |" + " |"*len(grid.cases))
        lines.append(f"| {method[1]} | " + " | ".join(form(grid.row(method, case)) for case in grid.cases) + " |")
    return [*lines, ""]


def messages(rows):
    """One line for each verdict and cause, over the cases of a refusal and the methods of a case: the first message, and how many had it"""
    found = {}
    for row in rows:
        if row["verdict"] not in ("survives", "not in this build"):
            cause = row["reason"].rsplit(": ", 1)[-1] if row["verdict"] == "fails" else row["reason"]
            where = row["label"] if row["reason"].startswith("&method") else row["case"]
            found.setdefault((where, row["verdict"], cause), []).append(row)
    lines = []
    for (where, verdict, _), same in found.items():
        others = f" ({len(same)} {'cases' if where == same[0]['label'] else 'methods'})" if len(same) > 1 else ""
        lines.append(f"- {where}, {verdict}{others}: {same[0]['label']}: {same[0]['reason']}")
    return [*(lines or ["None failed."]), ""]


def draw(rows, path):
    """The survival table as a picture: methods by cases, coloured; the largest stable Courant numbers beside it"""
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Patch, Rectangle
    cases, limits = Grid(rows, "case"), Grid(rows, "courant")
    methods = list(dict.fromkeys(cases.methods + limits.methods))
    columns = len(limits.cases) + len(cases.cases)
    gap = 0.4 if limits.cases and cases.cases else 0.0
    groups = [group for k, (group, _) in enumerate(methods) if group and (k == 0 or methods[k - 1][0] != group)]
    height = len(methods) + len(groups)
    longest = max(len(label) for _, label in methods)
    figure, axes = plt.subplots(figsize=(max(6.0, 1.2 + 0.065*longest + 0.78*columns), 2.8 + 0.235*height), layout="constrained")

    def put(x, y, colour, text):
        axes.add_patch(Rectangle((x, y), 1, 1, facecolor=colour, edgecolor="white", linewidth=1.2))
        axes.text(x + 0.5, y + 0.52, text, ha="center", va="center", fontsize=7, color="white" if colour in LIGHT else "black")

    y, names = 0.0, []
    for k, method in enumerate(methods):
        if method[0] and (k == 0 or methods[k - 1][0] != method[0]):
            axes.text(-0.15, y + 0.6, method[0], ha="right", va="center", fontsize=8, fontweight="bold")
            y += 1
        names.append((y + 0.5, method[1]))
        for x, case in enumerate(limits.cases):
            row = limits.row(method, case)
            colour = "#f0f0f0" if row is not None and "limit" in row else "#ffffff"
            put(x, y, COLOURS["defect"] if kind(row) == "defect" else colour, courant(row).split(" (")[0])
        for x, case in enumerate(cases.cases, len(limits.cases)):
            row = cases.row(method, case)
            put(x + gap, y, COLOURS[kind(row)], short(row).replace("fails ", "× "))
        y += 1
    axes.set(xlim=(0, columns + gap), ylim=(y, 0))
    axes.set_yticks([at for at, _ in names], [name for _, name in names], fontsize=7.5)
    at = [x + 0.5 for x in range(len(limits.cases))] + [x + 0.5 + gap for x in range(len(limits.cases), columns)]
    labels = [f"Courant,\n{case}" for case in limits.cases] + [case.replace("_", " ") for case in cases.cases]
    axes.set_xticks(at, labels, fontsize=7.5, rotation=50, ha="left", rotation_mode="anchor")
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    used = {kind(cases.row(method, case)) for method in methods for case in cases.cases}
    axes.legend(handles=[Patch(facecolor=COLOURS[name], edgecolor="0.7", label=MEANING[name]) for name in COLOURS if name in used],
                  loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, fontsize=7.5, frameon=False)
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as problem:
        raise gf.GimpError(f"{path}: cannot be written ({problem})") from None
    plt.close(figure)

"""Scenes drawn at random, with what meets at borders of ranks: sides of all kinds near each other, few cells, bodies that leave or are
alone, every basis with every transfer, wide supports, loads, damping, remedies. The same number gives the same scene everywhere."""
import random

BASES = [{"basis": "linear"}, {"basis": "ugimp"}, {"basis": "cpgimp", "domain": "stretch"}, {"basis": "cpgimp", "domain": "diagonal"},
         {"basis": "cpdi"}, {"basis": "cpdi2"}, {"basis": "ddmp"}, {"basis": "gauss_gimp", "quadrature": "simpson"},
         {"basis": "bspline2", "spline_boundary": "ghost"}, {"basis": "bspline3", "spline_boundary": "ghost"}, {"basis": "bspline2"},
         {"basis": "bspline3"}]
TRANSFERS = [{"transfer": "flip"}, {"transfer": "apic"}, {"transfer": "tpic"}, {"transfer": "mls"}, {"transfer": "pic"},
             {"transfer": "xpic", "transfer_order": 3}, {"transfer": "fmpm", "transfer_order": 2, "transfer_every": 2}]
SIDES = ["periodic", "symmetry", "slip", "stick", "free", "remove", "moving"]


def chance_scene(number):
    """The text of a scene; some are refused (a method that does not go with another or with a side), and some fail on the way"""
    dice = random.Random(number)
    dim = dice.choice((1, 2, 2, 3, 3))
    cells = [dice.choice(((40, 63, 64, 70, 130, 200), (5, 8, 13, 21, 24, 40), (3, 5, 8, 10, 13, 16))[dim - 1]) for _ in range(dim)]
    method = {**dice.choice(BASES), **dice.choice(TRANSFERS), "stress_update": dice.choice(("usl", "musl", "usf", "usavg")),
              "sort_every": dice.choice((3, 7, 11))}
    sides = [side_of_axis(dice, "xyz"[k]) for k in range(dim)]
    more = dice.choice([{}, {}, {}, {"damping": "kinetic"}, {"damping": "local", "damping_factor": 0.3}, {"anti_locking": "f_bar"},
                        {"anti_locking": "b_bar"}, {"anti_locking": "cell_stress"}, {"null_space_filter": 5}, {"kernel": "list"},
                        {"redistribute_mass": 0.05}, {"integrator": "generalized_alpha"}, {"integrator": "newmark"}, {"half_step_start": True}])
    method |= more
    if "integrator" in more:
        method = {**{key: word for key, word in method.items() if key not in ("stress_update", "transfer_order", "transfer_every")}, "transfer": "flip"}
    if any("periodic" in side or "symmetry" in side for side in sides) and method["basis"].startswith("bspline"):
        method["spline_boundary"] = "ghost"
    if method["transfer"] == "mls" and method.get("spline_boundary") != "ghost":
        method["transfer"] = "flip"
    text = f"&scene dimension = {dim} /\n&grid lower = {row([0.0]*dim)} upper = {row(float(c) for c in cells)} spacing = 1.0 /\n"
    text += """&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 /
&material name = "metal" model = "hencky_von_mises" density = 2000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 yield_stress = 1.0e3 /
"""
    text += "".join(body(dice, dim, cells, k) for k in range(dice.choice((1, 2, 3)))) + "".join(sides)
    text += f"&load kind = \"gravity\" acceleration = {row([0.0]*(dim - 1) + [-9.81])} /\n"
    if dice.random() < 0.3:
        point = row(dice.uniform(0.0, c) for c in cells)
        text += f'&load kind = "point_force" body = "body1" force = {row([50.0]*dim)} point = {point} ramp_time = 0.1 /\n'
    if dice.random() < 0.3:
        text += '&load kind = "pressure" body = "body1" face = "all" pressure = 2.0e3 times = 0.0, 0.2 factors = 0.0, 1.0 /\n'
    words = " ".join(f"{key} = " + (f'"{word}"' if isinstance(word, str) else f".{word}.".lower() if isinstance(word, bool) else str(word))
                     for key, word in method.items())
    redo = dice.random() < 0.2
    check = "" if "anti_locking" in more else ' stability_check = "gershgorin" stability_every = 13'
    time = "redo_unstable_steps = .true. courant = 0.8" if redo else dice.choice(("courant = 0.4", "courant = 0.4" + check))
    probes = row(x for _ in range(2) for x in [dice.uniform(0.0, c) for c in cells])
    text += f"&method {words} /\n&time end = 100.0 max_steps = 60 {time} /\n"
    return text + f"&output name = \"x\" history_every = 3 precision = \"double\" fields = \"velocity\", \"stress\", \"smoothed_stress\" probes = {probes} /\n"


def row(values):
    return ", ".join(str(round(value, 3)) for value in values)


def side_of_axis(dice, axis):
    """&boundary groups of both sides"""
    kinds = [dice.choice(SIDES) for _ in range(2)]
    if "periodic" in kinds:
        kinds = ["periodic"]*2
    text = ""
    for side, kind in zip(("low", "high"), kinds):
        more = ' leaving = "remove"' if kind == "remove" else " velocity = {zeros}" if kind == "moving" else ""
        word = {"remove": "free", "moving": "stick"}.get(kind, kind)
        text += f'&boundary side = "{axis}_{side}" condition = "{word}"{more if kind != "moving" else ""} /\n'
    return text


def body(dice, dim, cells, k):
    """A box somewhere, perhaps across all of an axis, perhaps a single particle, perhaps fast, perhaps stretched"""
    low, high = [], []
    for c in cells:
        if dice.random() < 0.25:
            low.append(0.0)
            high.append(float(c))
        else:
            a = round(dice.uniform(0.0, c - 1.5), 1)
            low.append(a)
            high.append(round(min(float(c), a + dice.choice((1.5, 3.0, 9.0, 20.0))), 1))
    lone = dice.random() < 0.1
    if lone:
        high = [a + 1.0 for a in low]
    speed = dice.choice((0.0, 2.0, 15.0))
    more = ""
    if dice.random() < 0.15:
        f = [[0.0]*dim for _ in range(dim)]
        for i in range(dim):
            f[i][i] = dice.choice((1.0, 1.2, 3.6))
        more = f" deformation_gradient = {row(x for line in f for x in line)}"
    return (f'&body name = "body{k + 1}" material = "{dice.choice(("rubber", "metal"))}" shape = "box" lower = {row(low)} upper = {row(high)}'
            f" particles_per_axis = {1 if lone else dice.choice((1, 2, 2, 3) if dim < 3 else (1, 2))} velocity = {row(dice.uniform(-speed, speed) for _ in cells)}{more} /\n")

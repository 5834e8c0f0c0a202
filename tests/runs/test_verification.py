"""What the program must show: errors, rates and failures of the cases with exact or published answers.

The reference figures were measured with an independent implementation of the same algorithms (docs/verification.md). Its runs
and ours differ by round-off and by the mass cut-off, so agreement is far better than the 5 % asked here; the tests accept what a
reader of the tables would call the same number.
"""
import math

import numpy as np
import pytest

import namelist
from conftest import INPUTS

FIVE_PERCENT = 0.05
SCHEMES = ["usl", "musl", "usf", "usavg"]
BASES = ["linear", "ugimp", "cpgimp"]
FEW_FRAMES = {"output__every": 0.0}


def rates(errors):
    """Orders of convergence between neighbouring grids, each half as wide as the one before"""
    return [math.log2(a/b) for a, b in zip(errors, errors[1:])]


def basis_keys(basis, domain=None):
    """Keys that choose a basis; `domain` is for cpgimp alone and None takes it away"""
    return {"method__basis": basis, "method__domain": domain if basis == "cpgimp" else None}


@pytest.fixture
def measure(run_scene, tmp_path):
    """A function measure(name, **overrides) -> Run of a scene of inputs/ that succeeded, with first and last frame only"""
    count = iter(range(1000))

    def run(name, **overrides):
        folder = tmp_path / str(next(count))
        folder.mkdir()
        return run_scene(INPUTS / f"{name}.nml", folder, **{**FEW_FRAMES, **overrides}).succeeded()

    return run


# ---------------------------------------------------------------------------------------- axis-aligned motion


AXIS_ALIGNED_2D = {8: 6.02e-2, 16: 1.06e-2, 32: 2.41e-3, 64: 5.86e-4}


@pytest.mark.parametrize("cells", [8, 16, 32, pytest.param(64, marks=pytest.mark.long)])
def test_axis_aligned_2d_has_the_errors_of_the_table(measure, cells):
    diagonal = measure("axis_aligned_2d", grid__spacing=1.0/cells).summary
    assert diagonal["error_rms"] == pytest.approx(AXIS_ALIGNED_2D[cells], rel=FIVE_PERCENT)
    assert diagonal["error_scale"] == 0.05
    stretch = measure("axis_aligned_2d", grid__spacing=1.0/cells, method__domain="stretch").summary
    # U = F in the exact motion. The computed one has a shear of the size of its error at the walls (F_xy up to 2e-3 at h = 1/8),
    # and U_xx - F_xx is half its square: 1e-6 of a half length
    assert stretch["error_rms"] == pytest.approx(diagonal["error_rms"], rel=1e-5)


def test_axis_aligned_2d_is_second_order(measure):
    errors = [measure("axis_aligned_2d", grid__spacing=1.0/n).summary["error_rms"] for n in (8, 16, 32)]
    assert min(rates(errors)) >= 1.9


def test_axis_aligned_2d_ugimp_stalls(measure):
    """Fixed domains overlap once the body is strained: refinement stops helping"""
    errors = {n: measure("axis_aligned_2d", grid__spacing=1.0/n, **basis_keys("ugimp")).summary["error_rms"] for n in (8, 16, 32)}
    for n, wanted in {8: 7.45e-2, 16: 1.41e-2, 32: 5.63e-3}.items():
        assert errors[n] == pytest.approx(wanted, rel=FIVE_PERCENT)


@pytest.mark.long
def test_axis_aligned_2d_ugimp_gains_nothing_from_the_finest_grid(measure):
    error = measure("axis_aligned_2d", grid__spacing=1.0/64, **basis_keys("ugimp")).summary["error_rms"]
    assert error == pytest.approx(5.69e-3, rel=FIVE_PERCENT)


def test_axis_aligned_2d_linear_stays_wrong(measure):
    """Hats that particles cross: a code with a small error here does not run the method it names"""
    for n in (16, 32):
        assert measure("axis_aligned_2d", grid__spacing=1.0/n, **basis_keys("linear")).summary["error_rms"] > 0.1


def test_axis_aligned_2d_usf_is_first_order(measure):
    errors = [measure("axis_aligned_2d", grid__spacing=1.0/n, method__stress_update="usf").summary["error_rms"] for n in (8, 16, 32)]
    assert errors == pytest.approx([1.70e-1, 7.48e-2, 3.58e-2], rel=FIVE_PERCENT)
    assert 0.9 < rates(errors)[-1] < 1.2  # the table has 1.06


def test_axis_aligned_2d_usavg_on_staggered_velocities_is_first_order(measure):
    errors = [measure("axis_aligned_2d", grid__spacing=1.0/n, method__stress_update="usavg").summary["error_rms"] for n in (16, 32)]
    assert errors[-1] == pytest.approx(1.9e-2, rel=FIVE_PERCENT)
    assert 0.9 < rates(errors)[-1] < 1.3  # the table has 1.15


def test_axis_aligned_2d_musl(measure):
    errors = [measure("axis_aligned_2d", grid__spacing=1.0/n, method__stress_update="musl").summary["error_rms"] for n in (8, 16, 32)]
    assert errors == pytest.approx([5.30e-2, 9.64e-3, 2.30e-3], rel=FIVE_PERCENT)


@pytest.mark.parametrize("scheme, wanted", [("usl", [4.31e-2, 7.57e-3, 1.73e-3, 4.20e-4]), ("musl", [3.80e-2, 6.91e-3, 1.65e-3, 4.19e-4])])
def test_axis_aligned_1d_has_the_errors_of_the_table(measure, scheme, wanted):
    errors = [measure("axis_aligned_1d", grid__spacing=1.0/n, method__stress_update=scheme).summary["error_rms"] for n in (8, 16, 32, 64)]
    assert errors == pytest.approx(wanted, rel=FIVE_PERCENT)


def test_stretch_and_diagonal_domains_are_the_same_in_1d(measure):
    """No shear can arise: only the round-off of a square root lies between the two, in each of 279 steps"""
    errors = [measure("axis_aligned_1d", method__domain=domain).summary["error_rms"] for domain in ("diagonal", "stretch")]
    assert errors[1] == pytest.approx(errors[0], rel=1e-10)


def test_axis_aligned_3d_is_second_order(measure):
    """There is no table in 3D; the first two grids of the 1D and 2D tables have rate 2.5, the theory 2"""
    errors = [measure("axis_aligned_3d", grid__spacing=1.0/n).summary["error_rms"] for n in (8, 16)]
    assert rates(errors)[0] >= 1.9
    assert errors[0] < 0.1


def test_small_amplitude_is_second_order_for_every_basis(measure):
    """No particle changes its cell at A = 1e-4, so nothing can spoil the order"""
    for basis, wanted in (("linear", [9.84e-3, 2.21e-3]), ("ugimp", [9.86e-3, 2.22e-3]), ("cpgimp", [9.86e-3, 2.22e-3])):
        errors = [measure("axis_aligned_2d", grid__spacing=1.0/n, verification__amplitude=1e-4, **basis_keys(basis, "diagonal"))
                  .summary["error_rms"] for n in (16, 32)]
        assert errors == pytest.approx(wanted, rel=FIVE_PERCENT)
        assert rates(errors)[0] >= 1.9


# ---------------------------------------------------------------------------------------- vibrating bar


BAR = {  # rms/(v0/omega) with 8, 16, 32, 64, 128 cells
    ("linear", "usl"): [1.97e-2, 4.79e-3, 1.18e-3, 2.94e-4, 7.33e-5],
    ("linear", "musl"): [1.91e-2, 4.71e-3, 1.17e-3, 2.93e-4, 7.32e-5],
    ("linear", "usf"): [3.02e-2, 1.07e-2, 4.20e-3, 1.82e-3, 8.35e-4],
    ("ugimp", "usl"): [2.12e-2, 5.01e-3, 1.21e-3, 2.98e-4, 7.38e-5],
    ("ugimp", "musl"): [1.91e-2, 4.71e-3, 1.17e-3, 2.93e-4, 7.32e-5],
    ("ugimp", "usf"): [3.02e-2, 1.07e-2, 4.20e-3, 1.82e-3, 8.35e-4],
    ("cpgimp", "usl"): [2.12e-2, 5.01e-3, 1.21e-3, 2.98e-4, 7.38e-5],
    ("cpgimp", "musl"): [1.91e-2, 4.71e-3, 1.17e-3, 2.93e-4, 7.32e-5],
    ("cpgimp", "usf"): [3.02e-2, 1.07e-2, 4.20e-3, 1.82e-3, 8.35e-4],
}


@pytest.mark.parametrize("basis, scheme", BAR, ids=lambda word: word)
def test_vibrating_bar_has_the_errors_and_rates_of_the_table(measure, basis, scheme):
    errors = []
    for n in (8, 16, 32, 64, 128):
        h = 25.0/n
        errors.append(measure("vibrating_bar", grid__spacing=h, grid__upper=25.0 + 2*h, method__basis=basis,
                              method__stress_update=scheme).summary["error_rms"])
    assert errors == pytest.approx(BAR[basis, scheme], rel=FIVE_PERCENT)
    if scheme == "usf":
        assert all(1.1 <= rate <= 1.55 for rate in rates(errors))  # the table falls from 1.50 to 1.12
    else:
        assert rates(errors)[-2:] == pytest.approx([2.0, 2.0], abs=0.05)


@pytest.mark.parametrize("scheme, wanted", [("usf", 1.00050), ("usl", 0.99919), ("musl", 0.99969)])
def test_vibrating_bar_keeps_its_energy_over_ten_periods(measure, scheme, wanted):
    """The kinetic energy lives at half steps, which adds a ripple of up to 0.8 %; at a whole number of periods it is small"""
    run = measure("vibrating_bar", method__stress_update=scheme, method__basis="ugimp", verification__speed=0.02, time__end=100.0)
    energy = run.history["kinetic_energy"] + run.history["stored_energy"]
    # 1e-3: the stored energy of a rate form is an estimate from the present stress, second order in the strain (0.002) here
    assert energy[-1]/energy[0] == pytest.approx(wanted, abs=1e-3)
    assert energy.max()/energy[0] < 1.01


# ---------------------------------------------------------------------------------------- vortex and ring


def test_vortex_has_the_errors_of_the_table(measure):
    for n, wanted in {8: 3.01e-2, 16: 5.29e-3}.items():
        assert measure("vortex", grid__spacing=1.0/n).summary["error_rms"] == pytest.approx(wanted, rel=FIVE_PERCENT)
    assert measure("vortex").summary["error_rms"] == pytest.approx(1.56e-3, rel=FIVE_PERCENT)


def test_vortex_at_its_largest_twist(measure):
    run = measure("vortex", grid__spacing=1.0/16, time__end=0.5)
    assert run.summary["error_rms"] == pytest.approx(3.0e-3, rel=FIVE_PERCENT)


def test_expanding_ring_has_the_errors_of_the_table(measure):
    """The stairs of the fill hide the order of the method: judge by the table, not by a rate"""
    for n, wanted in {16: 2.27e-2, 32: 4.16e-2, 64: 1.26e-2}.items():
        run = measure("expanding_ring", grid__spacing=1.0/n)
        assert run.summary["error_rms"] == pytest.approx(wanted, rel=FIVE_PERCENT)
        assert run.summary["error_scale"] == 0.1


# ---------------------------------------------------------------------------------------- rigid motion


@pytest.mark.parametrize("transfer", ["flip", "pic"])
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("basis", BASES)
def test_rigid_translation_through_ten_cells_changes_nothing(measure, basis, scheme, transfer):
    # Hats with USL multiply round-off by courant^2/distance whenever a particle is that close (in cells) behind a node, so that a
    # stiff block breaks down at small speed: the light-node instability, not a defect. A soft block crosses in few steps.
    modulus = 1.0e3 if (basis, scheme) == ("linear", "usl") else 1.0e6
    run = measure("rigid_translation", material__young_modulus=modulus, method__basis=basis, method__stress_update=scheme,
                  method__transfer=transfer)
    summary, particles = run.summary, run.last_frame
    # A sum over some 1300 steps of the round-off of numbers near 1 (positions in cells: up to 20); measured 1e-14 to 2e-13
    assert np.abs(particles["velocity"] - [0.7, -0.3, 0.0]).max() < 1e-12
    assert summary["error_max"] < 1e-12
    assert np.abs(particles["stress"]).max() < 1e-12*modulus  # of Young's modulus: the strain is zero to 1e-12
    for axis in "xy":
        momentum = run.history[f"momentum_{axis}"]
        assert np.abs(momentum - momentum[0]).max() < 1e-12*np.abs(momentum[0])
    assert summary["particles"] == run.history["particles"][0]


def test_rigid_rotation(measure):
    summary = measure("rigid_rotation", grid__spacing=0.1).summary
    # independent program: 6.9e-2 m; two grids of a case that is chaotic at the free corners agree to a few per cent
    assert summary["error_rms"] == pytest.approx(6.9e-2, rel=0.1)
    # affine transfers (the default) keep the rotation; the elastic strain of the spin is of this order
    assert measure("rigid_rotation", grid__spacing=0.1, method__transfer=None).summary["error_rms"] < 2e-3  # 1.06e-3 measured


@pytest.mark.parametrize("basis, scheme, fraction, momentum, energy", [
    ("linear", "usl", 1.0, 0.948, 0.907), ("linear", "musl", 1.0, 0.920, 0.914),
    ("ugimp", "usl", 1.0, 0.956, 0.925), ("ugimp", "musl", 1.0, 0.935, 0.934),
    ("cpgimp", "usl", 1.0, 0.956, 0.925), ("cpgimp", "musl", 1.0, 0.935, 0.934),
    ("cpgimp", "usl", 0.99, 0.522, 0.274)])
def test_spinning_disk_loses_what_flip_loses(measure, basis, scheme, fraction, momentum, energy):
    run = measure("spinning_disk", method__stress_update=scheme, method__deformation_update="forward",
                  method__flip_fraction=fraction, **basis_keys(basis, "stretch"))
    spin, kinetic = run.history["angular_momentum_z"], run.history["kinetic_energy"]
    # the table has three digits; MUSL turns round-off into differences of 1e-3 over a turn
    assert spin[-1]/spin[0] == pytest.approx(momentum, abs=5e-3)
    assert kinetic[-1]/kinetic[0] == pytest.approx(energy, abs=5e-3)


def test_spinning_disk_is_stopped_by_pic(measure):
    run = measure("spinning_disk", method__transfer="pic", method__flip_fraction=None, method__stress_update="usl")
    spin = run.history["angular_momentum_z"]
    assert abs(spin[-1]/spin[0]) < 1e-3


# ---------------------------------------------------------------------------------------- uniform stress


def bar_of_constant_stretch(folder, per_cell, cells=40, stretch=1.1, half=None):
    """Contiguous particles with F = stretch everywhere, and nearly massless ones at rest on the nodes, which show the velocity of
    every node after a step: the hat of a node is one there. Returns the positions of both."""
    h5py = pytest.importorskip("h5py")
    spacing = stretch/per_cell
    n = int((cells - 4)/spacing)
    line = 2.0 + spacing*(np.arange(n) + 0.5)
    nodes = np.arange(6.0, cells - 6.0)
    with h5py.File(folder/"line.h5", "w") as file:
        file["position"] = line[:, None]
        file["volume"] = np.full(n, spacing)
        file["mass"] = np.full(n, spacing)
        file["deformation_gradient"] = np.full((n, 1), stretch)
        file["half_length"] = np.full((n, 1), 0.5/per_cell)
    with h5py.File(folder/"nodes.h5", "w") as file:
        file["position"] = nodes[:, None]
        file["volume"] = np.full(len(nodes), 1e-15)
        file["mass"] = np.full(len(nodes), 1e-15)
        file["half_length"] = np.full((len(nodes), 1), 1e-9)
    return line, nodes


UNIFORM_STRESS = """
&scene dimension = 1 /
&grid lower = 0.0 upper = 40.0 spacing = 1.0 /
&material name = "rubber" model = "neo_hookean" density = 1.0 young_modulus = 1.0 poisson_ratio = 0.0 /
&body name = "line" material = "rubber" shape = "file" file = "line.h5" /
&body name = "nodes" material = "rubber" shape = "file" file = "nodes.h5" /
&method basis = "linear" stress_update = "usl" transfer = "pic" half_step_start = .false. mass_cutoff = 1.0e-20 /
&time end = 1.0e-3 step_rule = "fixed" step = 1.0e-3 /
&output name = "uniform" fields = "velocity" precision = "double" /
"""
STRESS = 0.5*(1.1**2 - 1.0)/1.1  # neo-Hookean with lambda = 0, mu = E/2: sigma = mu (F^2 - 1)/F


@pytest.mark.parametrize("per_cell", [1, 2, 3, 4])
@pytest.mark.parametrize("basis", BASES)
def test_uniform_stress_in_a_stretched_bar(run_scene, tmp_path, basis, per_cell):
    """The nodal force must vanish inside. Hats miss it by one particle: 1.1/ppc of the stress, on every grid."""
    line, nodes = bar_of_constant_stretch(tmp_path, per_cell)
    run = run_scene(UNIFORM_STRESS, tmp_path, method__basis=basis).succeeded()
    velocity = run.last_frame["velocity"][len(line):, 0]
    if basis == "linear":
        mass = np.array([np.clip(1.0 - np.abs(line - x), 0.0, None).sum() for x in nodes])*1.1/per_cell
        force = np.abs(velocity*mass/1.0e-3).max()/STRESS
        # The largest jump needs a particle just beside a node; 28 nodes see it to within a tenth of a cell at worst
        assert force == pytest.approx(1.1/per_cell, rel=0.02)
    else:
        mass = 1.0  # of a node inside, since the density of the bar is 1
        force = np.abs(velocity*mass/1.0e-3).max()/STRESS
        if basis == "cpgimp":
            assert force < 1e-12
        else:
            assert 0.02 < force < 0.12  # the table: 9.6e-2 for one particle per cell, 2.8e-2 for four


# ---------------------------------------------------------------------------------------- two disks


def two_disks(**more):
    """The set-up of the table: 20 x 20 cells on the unit square, step 0.005 s, plain start, forward F. The box is two cells wider
    on each side, because a disk beside a wall would stick to it and the table was measured without walls."""
    return {"grid__lower": [-0.1, -0.1], "grid__upper": [1.1, 1.1], "grid__spacing": 0.05, "time__step_rule": "fixed", "time__step": 0.005,
            "time__courant": None, "method__half_step_start": False, "method__deformation_update": "forward", "output__history_every": 1, **FEW_FRAMES, **more}


@pytest.mark.parametrize("basis, scheme, least, when, kinetic, total", [
    ("linear", "musl", 0.027, 1.935, 0.928, 0.999), ("linear", "usf", 0.026, 1.935, 0.936, 1.006),
    ("ugimp", "musl", 0.037, 1.94, 0.909, 0.999), ("ugimp", "usl", 0.030, 1.94, 0.892, 0.945),
    ("ugimp", "usf", 0.037, 1.935, 0.919, 1.005)])
def test_two_disks_exchange_the_energy_of_the_table(run_scene, tmp_path, basis, scheme, least, when, kinetic, total):
    run = run_scene(INPUTS / "two_disks.nml", tmp_path, **two_disks(method__basis=basis, method__stress_update=scheme)).succeeded()
    history = run.history
    moving = history["kinetic_energy"]/history["kinetic_energy"][0]
    assert history["kinetic_energy"][0] == pytest.approx(2.6, rel=1e-12)  # area of this fill times 10 J
    assert moving.min() == pytest.approx(least, abs=1e-3)
    assert history["time"][moving.argmin()] == pytest.approx(when, abs=0.011)  # two steps
    assert moving[-1] == pytest.approx(kinetic, rel=0.01)
    assert moving[-1] + history["stored_energy"][-1]/history["kinetic_energy"][0] == pytest.approx(total, rel=0.01)
    if scheme == "musl":  # USF with hats loses momentum at the mass cut-off, in the reference too
        assert np.abs(history["momentum_x"]).max() < 1e-12*history["mass"][0]*0.1


def test_two_disks_blow_up_with_linear_usl(run_scene, tmp_path):
    """A code that survives this does not run the method it names; a code that goes on after it hides it"""
    import gimp_files
    import h5py

    run = run_scene(INPUTS / "two_disks.nml", tmp_path, **two_disks(method__basis="linear", method__stress_update="usl", output__every=0.1))
    assert run.code == 1
    line = next(line for line in run.stderr.splitlines() if "the run failed" in line)
    for part in ("step ", "t = ", "dt = ", "particle ", " at ", " m: ", "inverted"):
        assert part in line
    assert "two_disks.vtkhdf" in run.stderr and "two_disks.failed.h5" in run.stderr
    assert "state_hash" not in run.stdout, "no closing table after a failure"

    assert run.summary["status"] == "failed"
    frames = list(gimp_files.frames(run.output, "all"))
    assert len(frames) >= 2
    assert np.allclose(run.times, 0.1*np.arange(len(frames)), atol=1e-12)
    for frame in frames:
        assert len(frame) == run.summary["particles"]
        assert all(np.isfinite(values).all() for values in (frame.points, *frame.fields.values()))
    step = int(line.split("step ")[1].split(",")[0])
    with h5py.File(tmp_path / "two_disks.failed.h5") as file:
        assert file["position"].shape == (run.summary["particles"], 2)
        assert file.attrs["step"] == step - 1
        assert line.endswith(file.attrs["reason"].decode() if isinstance(file.attrs["reason"], bytes) else file.attrs["reason"])


# ---------------------------------------------------------------------------------------- self-weight


def test_self_weight_column_comes_to_rest_at_the_exact_height(measure):
    def rest(**keys):
        run = measure("self_weight_column", output__fields=["displacement", "half_length", "stress"], output__precision="double", **keys)
        particles = run.last_frame
        return run, (particles["points"][:, 1] + particles["half_length"][:, 1]).max()

    # As shipped (h = 1.25) the top rests 1.07e-4 m low by discretisation and at 15 s still breathes by 2e-5 m, in a phase that follows
    # round-off; half the spacing leaves 3e-5 m, so that 1e-4 m of 1 m of settlement holds whatever the phase
    run, _ = rest()
    _, top = rest(grid__spacing=0.625, grid__upper=[0.625, 52.5], body__upper=[0.625, 50.0])
    assert top == pytest.approx(49.013330, abs=1e-4)
    assert run.summary["error_rms"] < 1e-5  # of the length of 50 m
    # The base carries the weight of 50 kN. 0.1 %: the column still breathes with an acceleration of 1e-4 of gravity
    assert run.history["reaction_y"][-1] == pytest.approx(50.0*1.25*800.0, rel=1e-3)
    assert np.abs(run.history["reaction_x"][-1]) < 1e-6*50.0e3  # by symmetry


def test_self_weight_column_converges_in_stress_with_cpgimp_and_not_with_linear(measure):
    def errors(basis):
        runs = [measure("self_weight_column", grid__spacing=h, grid__upper=[h, 55.0], body__upper=[h, 50.0], output__probes=None,
                        method__basis=basis) for h in (5.0, 2.5, 1.25)]
        return [run.summary["error_rms_stress"] for run in runs]
    assert min(rates(errors("cpgimp"))) > 0.9  # published: about first order; 1.5 measured
    crossing = errors("linear")
    assert crossing[2] > crossing[0]


# ---------------------------------------------------------------------------------------- books


@pytest.mark.long
@pytest.mark.parametrize("scene", sorted(INPUTS.glob("*.nml")), ids=lambda path: path.stem)
def test_energy_book_closes_over_a_whole_run(run_scene, tmp_path, scene):
    """The short version for every input is in test_inputs.py"""
    run = run_scene(scene, tmp_path, timeout=3000).succeeded()
    assert run.summary["status"] == "done"
    assert abs(run.summary["energy_residual"]) < 1e-12


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_energy_book_closes_for_every_scheme(run_scene, tmp_path, basis, scheme):
    """Contact with a wall, gravity, a blend of FLIP and PIC: every term of the book is at work"""
    text = namelist.set_key((INPUTS / "falling_disk.nml").read_text(), "method.basis", basis)
    run = run_scene(text, tmp_path, method__stress_update=scheme, method__flip_fraction=0.98, time__max_steps=150, grid__spacing=0.05,
                    **{"body.velocity": [0.5, -3.0], "boundary.condition": "stick"}).succeeded()
    assert abs(run.summary["energy_residual"]) < 1e-12
    assert abs(run.summary["momentum_residual"]) < 1e-12
    assert np.abs(run.history["reaction_work"]).max() + np.abs(run.history["external_work"]).max() > 0.0


@pytest.mark.parametrize("scene", ["axis_aligned_1d", "axis_aligned_2d", "self_weight_column", "vibrating_bar", "block_impact_3d"])
def test_momentum_book_closes_when_no_node_is_cut(measure, scene):
    """Sides, gravity, body forces and damping are all in it. A node below the mass cut-off loses its force, up to 1e-4 in the self-weight
    column, whose momentum is small; so here none is cut."""
    run = measure(scene, method__mass_cutoff=0.0, time__max_steps=400)
    assert run.summary["cut_nodes"] == 0
    assert abs(run.summary["momentum_residual"]) < 1e-12

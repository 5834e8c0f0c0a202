"""Weights at the places of the start: no particle crosses a cell, so that even tents keep their order at finite strain."""
import numpy as np
import pytest

from test_verification import measure, rates  # noqa: F401 (measure is a fixture)

TOTAL = {"method__formulation": "total", "method__domain": None}


@pytest.mark.parametrize("basis", ["linear", "cpgimp", "cpdi", "bspline2"])
def test_axis_aligned_2d_is_second_order_with_every_basis(measure, basis):
    """Updated tents stay at 0.13 of the amplitude at h = 1/32. What is left is discretisation: .0023 for tents and domains that tile,
    which are the same weights here; the open quadratic spline, whose updated form stalls at .0064, ends below it"""
    errors = [measure("axis_aligned_2d", grid__spacing=1.0/n, method__basis=basis, **TOTAL).summary["error_rms"] for n in (8, 16, 32)]
    assert rates(errors)[-1] > 1.9
    assert errors[-1] < (0.005 if basis == "bspline2" else 0.0025)


@pytest.mark.parametrize("transfer", ["flip", "apic"])
def test_spinning_disk_turns_rigidly(measure, transfer):
    """A quarter turn: F = R, so that forces must be those of P = tau F^-T and places those of the displacement"""
    run = measure("spinning_disk", method__basis="ugimp", method__transfer=transfer, method__flip_fraction=None, time__end=0.25,
                  output__fields=["reference_position"],
                  **TOTAL)
    spin = run.history["angular_momentum_z"]
    # FLIP loses 0.6 % in a quarter turn (updated: 1.1 %), the affine transfer nothing to speak of
    assert spin[-1] == pytest.approx(spin[0], rel=1e-2 if transfer == "flip" else 1e-4)
    x = run.last_frame["points"][:, :2] - 0.5
    start = x @ np.array([[0.0, -1.0], [1.0, 0.0]])  # turned back by a quarter
    reference = run.last_frame["reference_position"][:, :2] - 0.5
    assert np.sqrt(((start - reference)**2).sum(axis=1).mean()) < (0.04 if transfer == "flip" else 0.005)*0.3  # FLIP lags behind as it loses spin


@pytest.mark.parametrize("scene, basis", [("step_traction", "linear"), ("self_weight_column", "linear")])
def test_loads_and_history_as_in_the_updated_form(measure, scene, basis):
    """Where hardly anything moves, both forms say the same: the difference is of the order of the strain"""
    few = {"time__max_steps": 200}
    total = measure(scene, method__basis=basis, **TOTAL, **few)
    updated = measure(scene, method__basis=basis, method__domain=None, **few)
    for name in ("kinetic_energy", "stored_energy"):
        a, b = total.history[name], updated.history[name]
        assert np.abs(a - b).max() < 0.05*np.abs(b).max(), name
    assert abs(total.summary["energy_residual"]) < 1e-12 and abs(total.summary["momentum_residual"]) < 1e-12


def test_plastic_flow_in_both_forms(run_scene, tmp_path):
    """A bar that hits a wall and yields: the law gets L and dF of the present configuration. Both forms are within the error of their
    grids of each other"""
    work, length = [], []
    for form in ("total", "updated"):
        (tmp_path / form).mkdir()
        run = run_scene(f"""&scene dimension = 2 /
&grid lower = 0.0, 0.0 upper = 1.2, 0.6 spacing = 0.05 /
&material name = "metal" model = "hencky_von_mises" density = 1000.0 young_modulus = 1.0e6 poisson_ratio = 0.3 yield_stress = 1.0e4 /
&body name = "bar" material = "metal" shape = "box" lower = 0.0, 0.2 upper = 1.0, 0.4 velocity = -1.0, 0.0 /
&boundary side = "x_low" condition = "slip" /
&method basis = "cpgimp" formulation = "{form}" /
&time end = 0.03 courant = 0.2 /
&output name = "bar" every = 0.0 probes = 0.99, 0.3 /
""", tmp_path / form).succeeded()
        work.append(run.history["plastic_dissipation"][-1])
        length.append(run.history["probe1_x"][-1])
        assert abs(run.summary["energy_residual"]) < 1e-12
    assert work[0] > 0.1*0.5*1000.0*0.2*1.0  # a good part of the kinetic energy
    assert work[0] == pytest.approx(work[1], rel=0.05)
    assert 1.0 - length[0] == pytest.approx(1.0 - length[1], rel=0.05)


@pytest.mark.parametrize("basis", ["linear", "cpdi"])
def test_same_bits_on_any_number_of_threads(measure, basis):
    runs = [measure("spinning_disk", method__basis=basis, **TOTAL, time__max_steps=80, parallel__threads=threads)
            for threads in (1, 2, 3)]
    assert len({run.summary["state_hash"] for run in runs}) == 1

"""The dual domain method in whole runs: the tables of the reference implementation (alpha_max = 1), and what it does at free surfaces."""
import numpy as np
import pytest

from test_verification import FIVE_PERCENT, measure, rates  # noqa: F401 (measure is a fixture)

DDMP = {"method__basis": "ddmp", "method__domain": None, "method__ddmp_alpha": 1.0}

BAR = {  # rms/(v0/omega) with 8, 16, 32, 64, 128 cells; the box ends at the free end
    "usl": [2.64e-2, 6.49e-3, 1.62e-3, 4.04e-4, 1.01e-4],
    "musl": [2.58e-2, 6.41e-3, 1.61e-3, 4.02e-4, 1.01e-4],
    "usf": [3.64e-2, 1.23e-2, 4.63e-3, 1.92e-3, 8.63e-4],
}
SQUARE = {"usl": [8.47e-2, 1.36e-2, 5.27e-3], "musl": [8.08e-2, 1.38e-2, 6.57e-3]}  # h = 1/8, 1/16, 1/32
LINE = {"usl": [4.80e-2, 8.59e-3, 3.40e-3, 1.93e-3, 2.70e-3], "musl": [4.40e-2, 8.88e-3, 4.10e-3, 1.93e-3, 2.83e-2]}  # 8 to 128 cells


@pytest.mark.parametrize("scheme", BAR)
def test_vibrating_bar_has_the_errors_of_the_table(measure, scheme):
    errors = [measure("vibrating_bar", grid__spacing=25.0/n, grid__upper=25.0, method__stress_update=scheme, **DDMP)
              .summary["error_rms"] for n in (8, 16, 32, 64, 128)]
    assert errors == pytest.approx(BAR[scheme], rel=FIVE_PERCENT)
    if scheme != "usf":
        assert rates(errors)[-1] == pytest.approx(2.0, abs=0.03)


@pytest.mark.parametrize("scheme", SQUARE)
def test_axis_aligned_2d_has_the_errors_of_the_table(measure, scheme):
    errors = [measure("axis_aligned_2d", grid__spacing=1.0/n, method__stress_update=scheme, **DDMP).summary["error_rms"]
              for n in (8, 16, 32)]
    assert errors == pytest.approx(SQUARE[scheme], rel=FIVE_PERCENT)


@pytest.mark.parametrize("scheme", LINE)
def test_axis_aligned_1d_has_the_errors_of_the_table(measure, scheme):
    errors = [measure("axis_aligned_1d", grid__spacing=1.0/n, method__stress_update=scheme, **DDMP).summary["error_rms"]
              for n in (8, 16, 32, 64, 128)]
    assert errors == pytest.approx(LINE[scheme], rel=FIVE_PERCENT)


def test_small_amplitude(measure):
    errors = [measure("axis_aligned_2d", grid__spacing=1.0/n, verification__amplitude=1e-4, **DDMP).summary["error_rms"] for n in (8, 16, 32)]
    assert errors == pytest.approx([8.70e-2, 1.46e-2, 3.11e-3], rel=FIVE_PERCENT)


FREE = """&scene dimension = 2 /
&grid lower = 0.0, 0.0 upper = 1.0, 1.0 spacing = 0.05 /
&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 /
&body name = "block" material = "rubber" shape = "box" lower = 0.3, 0.32 upper = 0.62, 0.6 velocity = 1.0, 0.7
  velocity_gradient = 2.0, 1.0, -3.0, 1.5 /
&method basis = "ddmp" flip_fraction = 1.0 stress_update = "{scheme}" /
&time end = 1.0 max_steps = 150 /
&output name = "free" precision = "double" /
"""


@pytest.mark.parametrize("scheme", ["musl", "usf"])
def test_forces_of_nodes_without_mass_are_in_the_books(run_scene, tmp_path, scheme):
    """A free block sends force to nodes that carry no mass, where it is lost: momentum drifts, and the books know by how much"""
    run = run_scene(FREE.format(scheme=scheme), tmp_path).succeeded()
    assert run.summary["steps"] == 150
    momentum = np.column_stack([run.history["momentum_x"], run.history["momentum_y"]])
    assert np.linalg.norm(momentum[-1] - momentum[0]) > 0.1*np.linalg.norm(momentum[0])
    assert run.summary["momentum_residual"] < 1e-12
    assert run.summary["energy_residual"] < 1e-12


@pytest.mark.parametrize("scheme", ["musl", "usf"])
def test_handed_on_they_are_not_lost(run_scene, tmp_path, scheme):
    """With a tiny redistribute_mass the particle's own nodes take the force that nodes without mass were sent"""
    text = FREE.format(scheme=scheme).replace('basis = "ddmp"', 'basis = "ddmp" redistribute_mass = 1e-8').replace("velocity = 1.0, 0.7", "velocity = 0.7, 0.4")
    run = run_scene(text, tmp_path).succeeded()
    momentum = np.column_stack([run.history["momentum_x"], run.history["momentum_y"]])
    assert np.abs(momentum - momentum[0]).max() < 1e-12*np.linalg.norm(momentum[0])
    assert run.summary["momentum_residual"] < 1e-12


def test_material_must_stay_in_the_box(run_scene, tmp_path):
    run = run_scene(FREE.format(scheme="musl").replace("max_steps = 150", "").replace("velocity = 1.0, 0.7", "velocity = 3.0, 0.0"), tmp_path)
    assert run.code == 1
    assert "where the smeared gradients of ddmp end" in run.stderr

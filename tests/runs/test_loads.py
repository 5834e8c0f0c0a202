"""Loads on faces, in whole runs: a step traction on a bar and a pressure all round a block"""
import numpy as np
import pytest

from conftest import REPOSITORY

INPUTS = REPOSITORY / "inputs"
PRESSED = """&scene dimension = {d} /
&grid lower = {low} upper = {high} spacing = {h} /
&material name = "rubber" model = "hencky" density = 1000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 /
&body name = "block" material = "rubber" shape = "box" lower = {first} upper = {last} /
&load kind = "pressure" body = "block" face = "all" pressure = 5.0e3 ramp_time = 2.0 /
&method damping = "local" damping_factor = 0.3 {method} /
&time end = {end} /
&output name = "pressed" fields = "stress" /
"""


def test_tip_of_a_bar_under_a_step_traction_follows_the_triangle(run_scene, tmp_path):
    """u = p0 L/E times a triangle of period 4 L/c (exact). The wave front is a few cells wide, and the tip's particle sits half a
    particle inside: 2.4 % of p0 L/E at the worst on 100 cells"""
    run = run_scene(INPUTS / "step_traction.nml", tmp_path, output__history_every=1).succeeded()
    t, tip = run.history["time"], run.history["probe1_x"]
    phase = (t*10.0/25.0) % 4.0
    exact = 0.01*25.0/100.0*np.where(phase < 2.0, phase, 4.0 - phase)
    assert np.abs(tip - tip[0] - exact).max() < 0.03*0.0025
    assert run.summary["energy_residual"] < 1e-12 and run.summary["momentum_residual"] < 1e-12
    assert run.summary["lost_loads"] == 0


@pytest.mark.parametrize("d, h, end, basis", [(2, 0.05, 4.0, "cpgimp"), (2, 0.05, 4.0, "ugimp"), (3, 0.125, 3.0, "cpgimp"),
                                              (3, 0.125, 3.0, "ugimp"), (2, 0.05, 4.0, "bspline2"), (2, 0.05, 4.0, "bspline3"),
                                              pytest.param(3, 0.125, 3.0, "bspline2", marks=pytest.mark.long)])
def test_pressure_all_round_gives_that_stress(run_scene, tmp_path, d, h, end, basis):
    """In equilibrium a block under pressure on all faces carries -p in every direction that is free (plane strain holds the third).
    Mean over the middle of the block, away from the discrete edges: 1 %. (Hats miss it by 3 %: their points feel the faces of cells.)"""
    vector = lambda value: ", ".join([str(value)]*d)
    text = PRESSED.format(d=d, low=vector(0.0), high=vector(2.0), h=h, first=vector(0.5), last=vector(1.5), end=end,
                          method=f'basis = "{basis}"')
    run = run_scene(text, tmp_path).succeeded()
    frame = run.last_frame
    middle = (np.abs(frame["points"][:, :d] - 1.0) < 0.3).all(axis=1)
    stress = frame["stress"][middle].mean(axis=0)
    assert stress[:d] == pytest.approx([-5.0e3]*d, rel=0.01)
    assert np.abs(stress[3:]).max() < 5.0
    assert run.summary["momentum_residual"] < 1e-12
    assert np.abs([run.history[f"momentum_{k}"][-1] for k in "xyz"]).max() < 1e-6*run.history["mass"][0]  # it stays where it is


@pytest.mark.parametrize("method", ["", 'stress_update = "usf"', 'transfer = "flip" integrator = "generalized_alpha"',
                                    'transfer = "flip" integrator = "newmark"'])
def test_a_plane_of_symmetry_turns_loads_around_and_the_books_know(run_scene, tmp_path, method):
    """A body under pressure moves through a plane of symmetry: parts of the load go to images, and the plane turns their normal
    component around. Momentum is booked to round-off (without the plane's part 5e-7 was missing)"""
    text = PRESSED.format(d=2, low="0.0, 0.0", high="2.0, 2.0", h=0.1, first="0.0, 0.3", last="0.8, 1.1", end=0.1, method=method)
    text = text.replace('damping = "local" damping_factor = 0.3', "").replace("ramp_time = 2.0", "")
    text = text.replace('shape = "box"', 'shape = "box" velocity = -0.5, 0.4')
    run = run_scene(text + '&boundary side = "x_low" condition = "symmetry" /\n', tmp_path).succeeded()
    assert run.summary["momentum_residual"] < 1e-13 and run.summary["energy_residual"] < 1e-12

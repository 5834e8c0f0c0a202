"""Integrators beside the symplectic one: errors and rates of the table, what becomes of short waves, books, and the same bits.

Steps are given by their number, N = T c/(0.3 h), as the table was measured; a Courant number would mean a share of the method's own limit.
"""
import math

import h5py
import numpy as np
import pytest

import gimp_files
from conftest import INPUTS, check_same, on_threads, text_of, with_checkpoints
from test_matrix import collision, prove_same_bits, uncounted
from test_restart import BLOCK, PERIODIC

FEW_FRAMES = {"output__every": 0.0, "output__history_every": 1000}
CHANGES = ("generalized_alpha", "newmark")


def integrator(name, **more):
    """Overrides that choose an integrator, in scenes whose method was another one"""
    method = {"integrator": name, "stress_update": None, "half_step_start": None, **more}
    return {f"method__{key}": value for key, value in method.items()}


def bar(run, folder, cells, **more):
    """The vibrating bar of verification.md on so many cells"""
    h = 25.0/cells
    return run(INPUTS / "vibrating_bar.nml", folder, grid__spacing=h, time__courant=None,
               time__steps=math.ceil(11.25*10.0/(0.3*h) - 1e-9), **FEW_FRAMES, **more).succeeded()


@pytest.mark.parametrize("method, expected", [
    (integrator("generalized_alpha", spectral_radius=1.0), 8.6e-4), (integrator("generalized_alpha"), 8.6e-4),
    (integrator("generalized_alpha", spectral_radius=0.5), 8.8e-4), (integrator("newmark"), 1.17e-3)], ids=["alpha 1", "alpha 0.8", "alpha 0.5", "newmark"])
def test_bar_is_of_second_order(run_scene, tmp_path, method, expected):
    """Figures of the reference implementation, two digits"""
    error = []
    for cells in (32, 64):
        folder = tmp_path / str(cells)
        folder.mkdir()
        run = bar(run_scene, folder, cells, **method)
        error.append(run.summary["error_rms"])
        assert run.summary["energy_residual"] < 1e-13
        assert run.summary["momentum_residual"] < 1e-13
        assert abs(run.summary["energy_drift"]) < 1e-3  # leap-frog: 7e-3, since its velocities lag
    assert error[0] == pytest.approx(expected, rel=0.02)
    assert math.log2(error[0]/error[1]) == pytest.approx(2.03, abs=0.05)


CHAIN = """
&scene dimension = 1 /
&grid lower = 0.0 upper = 32.0 spacing = 1.0 /
&material name = "bar" model = "linear_elastic" density = 1.0 young_modulus = 1.0 poisson_ratio = 0.0 /
&body name = "bar" material = "bar" shape = "file" file = "bar.h5" /
&boundary side = "x_high" condition = "stick" /
&method basis = "linear" transfer = "flip" flip_fraction = 1.0 stress_update = "usl" /
&time end = 54.0 step_rule = "fixed" step = 0.9 /
&output name = "chain" every = 54.0 fields = "velocity" precision = "double" /
"""


def test_short_waves_are_damped_and_long_ones_kept(run_scene, tmp_path):
    """Particles 1e-4 beyond nodes are a chain of 31 masses and springs, whose modes are known and which hardly feel the transfers. The shortest
    wave has omega dt = 1.8: the spectral radius there is 0.69, 0.97 and 1 for rho_b = 0.5, 0.8 and 1, so that 3e-10, a fifth and all of it is left
    after 60 steps, give or take a factor for the phase (amplitudes of v and omega u are not what a step with large omega dt keeps)."""
    i = np.arange(1, 32)
    k = np.array([1, 31])
    mode = np.cos(np.outer(2*k - 1, i - 0.5)*np.pi/63.0)
    omega = 2.0*np.sin((2*k - 1)*np.pi/126.0)
    x = i + 1.0e-4
    with h5py.File(tmp_path / "bar.h5", "w") as file:
        file["position"] = x[:, None]
        file["volume"] = np.ones(31)
        file["mass"] = np.ones(31)
        file["velocity"] = (1.0e-7*mode.sum(axis=0))[:, None]
        file["half_length"] = np.full((31, 1), 0.25)

    def amplitudes(**more):
        run = run_scene(CHAIN, tmp_path, output__overwrite=True, **more).succeeded()
        return np.hypot(mode @ run.last_frame["velocity"][:, 0], omega*(mode @ (run.last_frame["points"][:, 0] - x)))/(mode**2).sum(axis=1)/1.0e-7

    found = {radius: amplitudes(**integrator("generalized_alpha", spectral_radius=radius)) for radius in (1.0, 0.8, 0.5)}
    for low, _ in found.values():
        assert low == pytest.approx(1.0, abs=2e-3)
    assert found[0.5][1] < 1e-6 < 0.1 < found[0.8][1] < 0.9 < found[1.0][1]
    assert amplitudes()[1] > 0.9  # leap-frog damps nothing


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("scene", [BLOCK, PERIODIC], ids=["sides", "periodic"])
def test_same_bits_on_threads_and_across_restarts(run_scene, tmp_path, name, scene):
    """From a checkpoint after the first step, too, when a memory begins; moving sides, loads, plasticity, particles that leave"""
    text = scene.replace("&time", "&method " + f"integrator = '{name}' /\n&time")
    runs = {}
    for threads in (1, 2, 5):
        (tmp_path / str(threads)).mkdir()
        runs[threads] = run_scene(on_threads(text, threads), tmp_path / str(threads)).succeeded()
        check_same(runs[1].output, runs[threads].output)
    summary = runs[1].summary
    assert summary["energy_residual"] < 1e-12 and summary["momentum_residual"] < 1e-12
    for at in (1, 2, 30):
        (tmp_path / f"from {at}").mkdir()
        run_scene(with_checkpoints(text_of(text, at), every_steps=at), tmp_path / f"from {at}").succeeded()
        rest = run_scene(on_threads(text, 3), tmp_path / f"from {at}", arguments=("--restart", "block.checkpoint.h5")).succeeded()
        check_same(runs[1].output, rest.output)


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("k, basis", enumerate(("ugimp", "cpgimp volume", "cpdi", "gauss simpson", "bspline2 open", "bspline3 ghost")))
def test_same_bits_with_every_kind_of_basis(run_scene, tmp_path, name, k, basis):
    """Two bodies that meet, in one to three dimensions, on two numbers of threads and across a restart"""
    prove_same_bits(run_scene, tmp_path, collision(1 + k % 3, basis, "flip", "usl").replace("&method ", f"&method integrator = '{name}' "),
                    (1, 3), f"{name} {basis}", uncounted())

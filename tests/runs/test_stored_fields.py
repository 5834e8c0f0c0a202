"""A particle stores what its scene needs, and the header says what and why"""
import re

import h5py
import numpy as np
import pytest

SCENE = """
&scene dimension = {d} /
&grid lower = {zero} upper = {one} spacing = 0.25 /
&material name = "steel" model = "{model}" density = 1000.0 young_modulus = 1.0e6 poisson_ratio = 0.3 {keys} /
&body name = "block" material = "steel" {shape} /
&method basis = "{basis}" transfer = "{transfer}" /
&time end = 1.0e-3 max_steps = 3 /
&output name = "stored" fields = "velocity" /
"""
MODELS = {"neo_hookean": "", "linear_elastic": "", "hencky_von_mises": "yield_stress = 10.0", "drucker_prager": "friction_angle = 30.0"}


def scene(d, model, basis="ugimp", transfer="flip", shape=None):
    return SCENE.format(d=d, zero=", ".join(["0.0"]*d), one=", ".join(["1.0"]*d), model=model, keys=MODELS[model], basis=basis,
                        transfer=transfer, shape=shape or "shape = 'box' lower = {} upper = {} particles_per_axis = 2".format(
                            ", ".join(["0.25"]*d), ", ".join(["0.75"]*d)))


@pytest.mark.parametrize("d, history", [(1, 4), (2, 5), (3, 7)])
@pytest.mark.parametrize("model", MODELS)
def test_history_is_as_long_as_the_dimension_asks(run_scene, tmp_path, d, history, model):
    run = run_scene(scene(d, model), tmp_path).succeeded()
    always = 8*(2*d + d*d + 2) + 8  # position, velocity, deformation, mass, volume, number
    expected = always + (0 if model == "neo_hookean" else 8*history)
    assert run.summary["state_bytes_per_particle"] == expected
    assert f"stored     {expected} bytes a particle: number 8 B, position {8*d} B" in run.stdout
    assert (f"state {8*history} B (history of steel)" in run.stdout) == (model != "neo_hookean")


def test_header_says_what_asks_for_a_field(run_scene, tmp_path):
    run = run_scene(scene(3, "neo_hookean", "cpgimp", "apic"), tmp_path).succeeded()
    assert re.search(r"domain 24 B \(basis = cpgimp\)\n +affine 72 B \(transfer = apic\)\n", run.stdout)


@pytest.mark.parametrize("d, component, words", [(2, 5, "out of the plane"), (1, 3, "out of the line"), (2, 3, None), (2, 2, None)])
def test_shear_that_a_dimension_cannot_have(run_scene, tmp_path, d, component, words):
    """It would not be stored: the particle file must not give it"""
    with h5py.File(tmp_path / "start.h5", "w") as file:
        file["position"] = np.full((2, d), 0.4) + 0.1*np.arange(2)[:, None]
        file["volume"] = np.full(2, 0.01)
        file["mass"] = np.full(2, 10.0)
        stress = np.zeros((2, 6))
        stress[1, component] = 5.0
        file["stress"] = stress
    run = run_scene(scene(d, "linear_elastic", shape="shape = 'file' file = 'start.h5'"), tmp_path)
    assert run.code == (2 if words else 0), run.stdout + run.stderr
    if words:
        assert f"stress of particle 2 has shear {words}: it must be zero" in run.stderr

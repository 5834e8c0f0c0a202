"""The objective rates of linear_elastic in whole runs: a soft, spinning block that hits two sticky walls"""
import numpy as np
import pytest

from conftest import check_same, on_threads, run_in_parts, text_of

RATES = {"hughes_winget": {}, "jaumann": {}, "green_naghdi": {}, "truesdell": {}, "logarithmic": {},
         "logarithmic symmetric": {"material.rate_form": "symmetric"}, "truesdell cayley": {"method.deformation_update": "cayley"}}
BLOCK = """&scene dimension = {dimension} /
&grid lower = {low} upper = {high} spacing = 0.125 /
&material name = "soft" model = "{model}" density = 1000.0 young_modulus = 1.0e4 poisson_ratio = 0.3 {rate} /
&body name = "block" material = "soft" shape = "box" lower = {from_} upper = {to} velocity = {velocity} angular_velocity = {spin}
  rotation_center = {centre} /
&boundary side = "all" condition = "stick" /
&method stress_update = "{scheme}" /
&time end = 0.3 step_rule = "fixed" step = 0.004 /
&output name = "x" every = 0.0 precision = "double" fields = "stress", "velocity" /
"""


def block(model, rate="", dimension=2, scheme="usl"):
    def first(*values):
        return ", ".join(str(x) for x in values[:dimension])
    return BLOCK.format(dimension=dimension, low=first(0.0, 0.0, 0.0), high=first(1.0, 1.0, 1.0), from_=first(0.125, 0.125, 0.25),
                        to=first(0.5, 0.625, 0.625), velocity=first(-1.0, -0.7, 0.3), spin="2.0" if dimension == 2 else "2.0, 1.0, -1.0",
                        centre=first(0.3, 0.4, 0.45), model=model, rate=f"rate = '{rate}'" if rate else "", scheme=scheme)


@pytest.mark.parametrize("case", RATES, ids=lambda case: case.replace(" ", "_"))
def test_books_close_and_a_restart_changes_no_bit(run_scene, tmp_path, case):
    """A particle keeps no more than with any other rate: stress and stress power"""
    text = text_of(block("linear_elastic", case.split()[0], scheme="musl"), **RATES[case])
    for folder in ("whole", "parts"):
        (tmp_path / folder).mkdir()
    whole = run_scene(on_threads(text, 1), tmp_path / "whole").succeeded()
    assert whole.summary["energy_residual"] < 1e-12 and whole.summary["momentum_residual"] < 1e-12
    assert whole.summary["steps"] == 75
    assert np.abs(whole.last_frame["stress"]).max() > 1.0e3, "a tenth of E: the rates have something to do"
    rest = run_in_parts(run_scene, tmp_path / "parts", text, 31, 75, (1, 2))
    check_same(whole.output, rest.output)


def difference(run_scene, folder, rate, dimension=2, scheme="usl", **keys):
    """Largest difference of stress, of E, between a rate and the Hencky law, and what of the stress remains"""
    stress = {}
    for model in ("hencky", "linear_elastic"):
        (folder / model).mkdir(parents=True)
        run = run_scene(text_of(block(model, rate if model == "linear_elastic" else "", dimension, scheme), **keys), folder / model).succeeded()
        stress[model] = run.last_frame["stress"]/1.0e4
    return np.abs(stress["hencky"] - stress["linear_elastic"]).max()


@pytest.mark.parametrize("dimension, scheme, update", [(2, "usl", "forward"), (2, "usavg", "cayley"), (2, "musl", "exponential"), (3, "musl", "forward")])
def test_the_logarithmic_rate_is_the_hencky_law(run_scene, tmp_path, dimension, scheme, update):
    """To second order in the step, with every increment of F; the other rates are other materials"""
    def error(step, rate="logarithmic"):
        return difference(run_scene, tmp_path / f"{rate}{step}", rate, dimension, scheme, **{
            "time.step": step, "time.end": 0.24, "method.deformation_update": update})
    coarse, fine = error(0.004), error(0.002)
    assert fine < 5e-5
    assert 3.5 < coarse/fine < 4.6
    if dimension == 2:
        assert error(0.004, "green_naghdi") > 20*coarse

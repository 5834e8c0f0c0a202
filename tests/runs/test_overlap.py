"""Domains that overlap (domain_overlap) in whole runs: both kernels agree, nothing is lost, and the output tells the domains of the weights"""
import h5py
import numpy as np
import pytest

from test_ddmp import FREE


@pytest.mark.parametrize("basis", ["ugimp", "cpgimp", "cpdi", "gauss_gimp"])
@pytest.mark.parametrize("overlap", [1.5, 3.0])
def test_both_kernels_agree(run_scene, tmp_path, basis, overlap):
    frames = []
    for kernel in ("auto", "list"):
        (tmp_path / kernel).mkdir()
        text = FREE.format(scheme="musl").replace('basis = "ddmp"', f'basis = "{basis}" transfer = "flip" domain_overlap = {overlap} kernel = "{kernel}"')
        text = text.replace("max_steps = 150", "max_steps = 30").replace("precision", "fields = 'velocity', 'half_length' precision")
        run = run_scene(text, tmp_path / kernel).succeeded()
        assert run.summary["momentum_residual"] < 1e-12
        assert run.summary["energy_residual"] < 1e-12
        frames.append(run.last_frame)
    for name in ("points", "velocity", "half_length"):
        assert np.abs(frames[0][name] - frames[1][name]).max() < 1e-10, name  # 30 steps of round-off
    if basis == "ugimp":
        assert frames[0]["half_length"][:, :2] == pytest.approx(0.0125*overlap, rel=1e-12)


def test_a_domain_that_is_too_long_is_refused(run_scene, tmp_path):
    with h5py.File(tmp_path / "long.h5", "w") as file:
        file["position"] = [[0.5, 0.5]]
        file["volume"] = [1e-4]
        file["mass"] = [0.1]
        file["half_length"] = [[0.06, 0.01]]
    text = FREE.format(scheme="musl").replace('basis = "ddmp"', 'basis = "ugimp" domain_overlap = 2.0')
    body = text[text.index("&body"):text.index("&method")]
    run = run_scene(text.replace(body, "&body name = 'one' material = 'rubber' shape = 'file' file = 'long.h5' /\n"), tmp_path)
    assert run.code == 2
    assert "a domain reaches 2.4 cells from its particle, domain_overlap included" in run.stderr

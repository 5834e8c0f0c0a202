"""Domains sampled at points (CPDI, GIMP weights by quadrature) in whole runs: the tables of the reference, failures included."""
import pytest

from test_verification import FIVE_PERCENT, measure, rates  # noqa: F401 (measure is a fixture)


def keys(basis, **more):
    """Keys that choose a basis; domains of the reference are never scaled"""
    return {"method__basis": basis, "method__domain": None, "method__domain_limit": 2.0,
            **{f"method__{key}": value for key, value in more.items()}}


SIMPSON, SURFACE = {"quadrature": "simpson"}, {"quadrature": "surface", "quadrature_points": 2}
VOLUME = {n: {"quadrature": "volume", "quadrature_points": n} for n in (1, 2, 3)}

BAR = {  # rms/(v0/omega) with 8, 16, 32, 64 cells
    "usl": [1.97e-2, 4.79e-3, 1.18e-3, 2.94e-4], "musl": [1.91e-2, 4.71e-3, 1.17e-3, 2.93e-4],
    "usf": [3.02e-2, 1.07e-2, 4.20e-3, 1.82e-3]}


@pytest.mark.parametrize("scheme", BAR)
def test_vibrating_bar_has_the_errors_of_the_table(measure, scheme):
    errors = [measure("vibrating_bar", grid__spacing=25.0/n, grid__upper=25.0 + 50.0/n, method__stress_update=scheme,
                      **keys("cpdi")).summary["error_rms"] for n in (8, 16, 32, 64)]
    assert errors == pytest.approx(BAR[scheme], rel=FIVE_PERCENT)


AXIS_ALIGNED_2D = [  # basis, its keys, scheme, rms/A at h = 1/8, 1/16, 1/32
    ("cpdi", {}, "usl", [6.63e-2, 1.25e-2, 2.87e-3]), ("cpdi", {}, "musl", [5.77e-2, 1.16e-2, 2.75e-3]),
    ("cpdi", {}, "usf", [1.74e-1, 7.60e-2, 3.61e-2]), ("gauss_gimp", SIMPSON, "usl", [6.1e-2, 1.08e-2, 2.43e-3]),
    ("gauss_gimp", SURFACE, "usl", [6.0e-2, 1.05e-2, 2.42e-3]),
    ("gauss_gimp", VOLUME[1], "usl", [.17, .12, .13]), ("gauss_gimp", VOLUME[2], "usl", [.11, .087, .12]),
    ("gauss_gimp", VOLUME[3], "usl", [.093, .069, .11])]


@pytest.mark.parametrize("basis, more, scheme, wanted", AXIS_ALIGNED_2D, ids=lambda value: str(value))
def test_axis_aligned_2d_has_the_errors_of_the_table(measure, basis, more, scheme, wanted):
    """The volume form does not converge (its gradients jump at faces), the others are of second order"""
    errors = [measure("axis_aligned_2d", grid__spacing=1.0/n, method__stress_update=scheme, **keys(basis, **more))
              .summary["error_rms"] for n in (8, 16, 32)]
    assert errors == pytest.approx(wanted, rel=FIVE_PERCENT)
    if more.get("quadrature") == "volume":
        assert errors[2] > 0.1
    elif scheme != "usf":
        assert rates(errors)[-1] > 1.9


@pytest.mark.long
@pytest.mark.parametrize("scheme, wanted", [("usl", [5.02e-4, 1.26e-4, 3.28e-5]), ("musl", [4.97e-4, 1.29e-4, 2.87e-3])])
def test_axis_aligned_1d_shows_what_musl_does_to_short_waves(measure, scheme, wanted):
    errors = [measure("axis_aligned_1d", grid__spacing=1.0/n, method__stress_update=scheme, **keys("cpdi")).summary["error_rms"]
              for n in (64, 128, 256)]
    assert errors == pytest.approx(wanted, rel=FIVE_PERCENT)


@pytest.mark.long
def test_vortex_on_the_finest_grid(measure):
    assert measure("vortex", grid__spacing=1.0/32, **keys("cpdi")).summary["error_rms"] == pytest.approx(1.52e-3, rel=FIVE_PERCENT)


def test_domains_longer_than_the_limit_are_shortened_and_counted(measure):
    """Scaling acts on the weights alone: the run goes on, tells how often, and its result differs"""
    short = measure("axis_aligned_2d", grid__spacing=0.125, **{**keys("cpdi"), "method__domain_limit": 0.35}).summary
    whole = measure("axis_aligned_2d", grid__spacing=0.125, **keys("cpdi")).summary
    assert short["clamped_domains"] > 0 == whole["clamped_domains"]
    assert short["error_rms"] != whole["error_rms"]

"""The number of threads changes no bit of the state: blocks add in a fixed order, whoever worked on them"""
import pytest

from conftest import REPOSITORY

INPUTS = REPOSITORY / "inputs"

# beside all inputs, bases, transfers and schemes, which are in test_matrix.py: runs with many blocks and cells crossed, which sort when
# they must, and wide supports, which spill beyond their pads
CASES = {
    "1d": ("axis_aligned_1d.nml", {"grid__spacing": 1.0/256, "time__max_steps": 60}),
    "2d": ("two_disks.nml", {"time__max_steps": 150, "output__every": 0.0}),
    "2d wide": ("falling_disk.nml", {"time__max_steps": 60, "output__every": 0.0, "body__deformation_gradient": [3.6, 0.0, 0.0, 0.8],
                                   "body__particles_per_axis": 1}),
    "3d": ("block_impact_3d.nml", {"time__max_steps": 80, "output__every": 0.0}),
    "3d spline": ("axis_aligned_3d.nml", {"time__max_steps": 40, "output__every": 0.0, "method__basis": "bspline3", "method__domain": None,
                                          "method__spline_boundary": "ghost", "boundary__condition": "symmetry"}),
    "3d usavg": ("axis_aligned_3d.nml", {"method__stress_update": "usavg", "output__every": 0.0, "time__max_steps": 30}),
}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.replace(" ", "_"))
def test_same_bits_on_any_number_of_threads(run_scene, tmp_path, case):
    scene, overrides = CASES[case]
    hashes, residuals = set(), set()
    for threads in (1, 2, 3, 4, 8):  # more threads than most scenes have blocks, and more than processors
        folder = tmp_path / str(threads)
        folder.mkdir()
        text = (INPUTS / scene).read_text() + f"\n&parallel threads = {threads} /\n"
        run = run_scene(text, folder, **overrides).succeeded()
        assert run.summary["threads"] == threads
        hashes.add(run.summary["state_hash"])
        residuals.add((run.summary["energy_residual"], run.summary["energy_drift"], run.summary["momentum_residual"]))
    assert len(hashes) == 1
    assert len(residuals) == 1  # the books too
    if case == "2d wide":
        assert run.summary["spilled_values"] > 0

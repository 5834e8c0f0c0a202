"""postprocessing/work_precision.py: a small study of the vibrating bar, interrupted, gone on with, drawn."""
import csv
import math

import pytest

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")

from conftest import INPUTS  # noqa: E402
from made_up import assert_drawn  # noqa: E402
import gimp_files as gf  # noqa: E402
import namelist  # noqa: E402
import work_precision  # noqa: E402
import work_precision_figure as show  # noqa: E402
import work_precision_overview  # noqa: E402
import work_precision_runs as runs  # noqa: E402

METHODS = """# two that run, one that cannot, one that no build knows, one that makes no sense
[good]
cpgimp: basis=cpgimp stress_update=musl
linear: basis=linear stress_update=usf    # first order
[bad]
too long a step: step_rule=fixed step=1.0 verification.speed=1.0
of the future: basis=cpgimp no_such_key=1
too much: flip_fraction=2
"""


@pytest.fixture
def study(gimp_x, tmp_path, monkeypatch, capsys):
    """A function study(*words) -> (rows of the table by label and cells, what was printed, what was said)"""
    monkeypatch.setenv("GIMP_X", str(gimp_x))
    (tmp_path / "methods.txt").write_text(METHODS)

    def run(*words):
        code = work_precision.main([str(INPUTS / "vibrating_bar.nml"), "--methods", str(tmp_path / "methods.txt"), "--cells", "16,32",
                                    "--csv", str(tmp_path / "study.csv"), *words])
        told = capsys.readouterr()
        assert code == 0
        return {(row["label"], row["cells"]): row for row in runs.read_rows(tmp_path / "study.csv")}, told.out, told.err

    return run


def test_a_study_from_runs_to_figure(study, tmp_path):
    rows, out, err = study("--table", str(tmp_path / "study.md"))
    assert len(rows) == 10 and "10 to run" in err
    for label in ("cpgimp", "linear"):
        coarse, fine = rows[label, "16"], rows[label, "32"]
        assert coarse["state"] == fine["state"] == "done"
        assert fine["h"] == 50/32 and fine["courant"] == "0.3"
        assert fine["particle_steps"] == fine["particles"]*fine["steps"] == 4*coarse["particle_steps"]  # twice the cells, half the step
        assert fine["core_seconds"] == fine["wall_seconds"]*1 > 0
        assert fine["processor_seconds"] > 0 and fine["timed_runs"] == 1
        assert abs(fine["energy_residual"]) < 1e-12
    # the tables of docs/verification.md, to their digits: 8 and 16 cells over the bar
    assert [rows["cpgimp", n]["error_rms"] for n in ("16", "32")] == pytest.approx([1.906e-2, 4.709e-3], rel=1e-3)
    assert [rows["linear", n]["error_rms"] for n in ("16", "32")] == pytest.approx([3.015e-2, 1.067e-2], rel=1e-3)

    assert rows["too long a step", "16"]["state"] == "failed" and "step " in rows["too long a step", "16"]["reason"]
    assert rows["of the future", "16"]["state"] == "not in this build" and "no_such_key" in rows["of the future", "16"]["reason"]
    assert rows["too much", "32"]["state"] == "refused" and "flip_fraction" in rows["too much", "32"]["reason"]
    for words in ("not in this build: of the future", "too long a step, 16 cells: failed: t = ", "too much, 16, 32 cells: refused: "):
        assert words in out, out

    # error ~ h^p and particle-steps ~ h^-2, so that the slope is -p/2
    line = next(text for text in (tmp_path / "study.md").read_text().splitlines() if text.startswith("| cpgimp"))
    cells = [cell.strip() for cell in line.split("|")[1:-1]]
    order = math.log2(1.906e-2/4.709e-3)
    assert cells[:4] == ["cpgimp", "1.906e-02", "4.709e-03", f"{order:.2f}"]
    assert float(cells[5]) == pytest.approx(-order/2, abs=0.006)  # two digits are printed
    assert_drawn(tmp_path / "study.png", width=1000, height=400)


def test_runs_that_are_there_are_not_repeated(study, tmp_path, monkeypatch):
    calls = []
    real = runs.measure
    monkeypatch.setattr(show, "draw", lambda *others: None)  # half of the time of this test

    def counted(case, *others):
        if len(calls) == 4:
            raise KeyboardInterrupt
        calls.append((case.method.label, case.key[3]))
        return real(case, *others)

    monkeypatch.setattr(runs, "measure", counted)
    with pytest.raises(KeyboardInterrupt):
        study()
    assert len(runs.read_rows(tmp_path / "study.csv")) == 4  # each row was written when its run had ended
    monkeypatch.setattr(runs, "measure", lambda case, *others: (calls.append((case.method.label, case.key[3])), real(case, *others))[1])
    rows, _, err = study()
    assert "6 to run, 4 in" in err and len(calls) == len(set(calls)) == 10
    before = (tmp_path / "study.csv").read_bytes()
    assert study()[0] == rows and len(calls) == 10
    assert (tmp_path / "study.csv").read_bytes() == before

    # a row of another commit does not serve, unless it is told to; other settings are other runs
    text = before.decode().replace(rows["cpgimp", "16"]["commit"], "0123456789ab")
    (tmp_path / "study.csv").write_text(text)
    study("--any-commit", "--only", "good")
    assert len(calls) == 10
    study("--only", "good")
    study("--only", "good", "--courant", "0.2")
    assert len(calls) == 18


def test_side_by_side_gives_the_same_errors_and_no_seconds(study, tmp_path):
    rows, _, _ = study("--jobs", "2", "--only", "good")
    assert all("core_seconds" not in row and "wall_seconds" not in row for row in rows.values())
    assert rows["cpgimp", "32"]["error_rms"] == pytest.approx(4.709e-3, rel=1e-3)
    assert_drawn(tmp_path / "study.png", width=1000, height=300)
    timed, out, err = study("--only", "cpgimp", "--repeat", "3", "--seconds", "processor")
    assert "2 to run" in err and timed["cpgimp", "32"]["core_seconds"] > 0 and "slope, proc.-s" in out
    assert timed["cpgimp", "32"]["timed_runs"] == 3 and timed["cpgimp", "32"]["slowest_over_fastest"] >= 1
    again, _, err = study("--only", "cpgimp", "--again", "--seconds", "processor")
    assert "2 to run" in err and again["cpgimp", "32"]["timed_runs"] == 4
    assert again["cpgimp", "32"]["processor_seconds"] <= timed["cpgimp", "32"]["processor_seconds"]
    assert timed["cpgimp", "32"]["state_hash"] == rows["cpgimp", "32"]["state_hash"]


def test_measures_of_the_history(study):
    """A bar that swings back and forth keeps its energy (to 1.5 %: velocities live at half steps); a blend with PIC loses some of it"""
    rows, out, _ = study("--methods", "flip_fraction=1.0|0.5", "--measure", "energy_loss")
    kept, lost = (rows[f"flip_fraction={q}", "32"] for q in ("1.0", "0.5"))
    assert runs.number_of(kept, "energy_loss") == abs(1 - kept["energy_kept"]) < 0.02 < 0.1 < runs.number_of(lost, "energy_loss") < 1
    assert f"{abs(1 - lost['energy_kept']):.3e}" in out


# ------------------------------------------------------------------------------------------- parts


def test_methods_as_text():
    several = runs.read_methods("one: basis=linear|cpgimp courant=0.1; transfer=apic output.every=2", ("courant",))
    assert [m.label for m in several] == ["one linear", "one cpgimp", "transfer=apic every=2"]
    assert several[0].settings == (("method.basis", "linear"), ("time.courant", "0.1"))
    assert several[2].settings == (("method.transfer", "apic"), ("output.every", "2"))
    for broken, message in (("basis", "key=value"), ("a: b=1; a: b=2", "two methods"), (" ; ", "no methods"), ("name:", "sets nothing")):
        with pytest.raises(gf.GimpError, match=message):
            runs.read_methods(broken)


def test_the_list_of_all_methods_can_be_read(gimp_x):
    methods = runs.read_methods(str(gf.REPOSITORY / "postprocessing" / "methods" / "all.txt"), *runs.time_keys(gimp_x)[:1])
    assert len(methods) > 20 and all(m.group for m in methods)
    assert len({m.text for m in methods if m.group == "bases"}) == len([m for m in methods if m.group == "bases"])


def test_keys_of_another_method_go_away(gimp_x):
    """The vortex says domain = "diagonal" for its cpgimp and flip_fraction = 1 for its flip"""
    keys, deciders = runs.time_keys(gimp_x)
    assert "courant" in keys and deciders["method.domain"] == {"method.basis"} and "method.transfer" in deciders["method.flip_fraction"]
    text = (INPUTS / "vortex.nml").read_text()
    (method,) = runs.read_methods("basis=linear transfer=apic step_rule=fixed step=0.1", keys)
    groups = {g.name: g.values() for g in namelist.groups(runs.with_method(text, method, deciders))}
    assert groups["method"] == {"basis": ["linear"], "transfer": ["apic"], "stress_update": ["usl"], "deformation_update": ["forward"]}
    assert groups["time"] == {"end": [1.0], "step_rule": ["fixed"], "step": [0.1]}
    (method,) = runs.read_methods("stress_update=usf domain=stretch", keys)
    changed = runs.with_method(text, method, deciders)
    assert runs.value_in(changed, "method.domain") == "stretch" and runs.value_in(changed, "method.flip_fraction") == 1.0


def test_slope_and_front():
    points = [(n**3, 7.0*n**-2.0) for n in (8, 16, 32)]
    assert show.slope(points) == pytest.approx(-2/3, rel=1e-12)
    assert math.isnan(show.slope(points[:1]))
    assert show.pareto([(1, 5), (2, 6), (3, 4), (3, 2), (9, 2)]) == [(1, 5), (3, 2)]


def test_a_foreign_table_is_left_alone(tmp_path):
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(gf.GimpError, match="is not a table of work_precision"):
        runs.read_rows(tmp_path / "other.csv")


def test_expected_values_have_known_labels():
    """Each expected number belongs to a method of the list and a scene of inputs/"""
    folder = gf.REPOSITORY / "postprocessing" / "methods"
    labels = {m.label for name in ("all", "tables") for m in runs.read_methods(str(folder / f"{name}.txt"))}
    scenes = {path.stem for path in INPUTS.glob("*.nml")}  # a study may have more in its name: vortex_half ends at half time
    with open(folder / "expected.csv", newline="") as file:
        for row in csv.DictReader(file):
            assert row["label"] in labels and any(row["scene"].startswith(scene) for scene in scenes) and float(row["expected"]) > 0


def test_overview_of_two_studies(tmp_path, capsys):
    """Costs against `linear` on the same grid, errors with the rate from the next coarser one"""
    for name, factor in (("a", 2.0), ("b", 4.0)):
        rows = [dict(scene=name, method=label, label=label, cells=str(n), h=1/n, precision="double", state="done", commit="c", threads="1",
                     error_rms=5.0*n**-2.0, energy_kept=1.5, particle_steps=n**3, core_seconds=n**3*1e-3*(factor if label == "cpgimp" else 1))
                for label in ("linear", "cpgimp") for n in (8, 16)]
        runs.write_rows(tmp_path / f"{name}.csv", rows)
    (tmp_path / "m.txt").write_text("[bases]\nlinear: basis=linear\ncpgimp: basis=cpgimp\ncpdi: basis=cpdi\n")
    work_precision_overview.main([f"{tmp_path}/a.csv:error_rms:16", f"{tmp_path}/b.csv:energy_loss:8", "--methods", str(tmp_path / "m.txt")])
    assert capsys.readouterr().out.splitlines()[2:] == [
        "| linear | 1.00 (1.00 to 1.00) | 1.95e-02 (2.0) | 5.00e-01 |",
        "| cpgimp | 3.00 (2.00 to 4.00) | 1.95e-02 (2.0) | 5.00e-01 |",
        "| cpdi | - | - | - |"]
    with pytest.raises(gf.GimpError, match="FILE:MEASURE:CELLS"):
        work_precision_overview.main([f"{tmp_path}/a.csv", "--methods", str(tmp_path / "m.txt")])

"""postprocessing/stability.py and the hard cases of inputs/hard: what the default method does with them, and that each kind of end is told
as what it is."""
import math
import re

import pytest

pytest.importorskip("h5py")
np = pytest.importorskip("numpy")
pytest.importorskip("matplotlib")

from conftest import HARD, INPUTS  # noqa: E402
from made_up import assert_drawn  # noqa: E402
import gimp_files as gf  # noqa: E402
import namelist  # noqa: E402
import stability  # noqa: E402
import stability_runs as st  # noqa: E402
import work_precision_runs as runs  # noqa: E402

LINEAR = "basis=linear transfer=flip flip_fraction=1"

# Largest error of the default method, in scales of the case: measured, with a fifth of room. None: it fails, and says why.
DEFAULT = {"edge_creep": 1.4e-3, "grazing_bodies": 0.021, "impact_half_mach": 0.039, "lone_particle": 1e-12, "long_rest": 0.01,
           "one_particle_per_cell": 0.0075, "particle_on_node": 1e-12, "punch_nearly_incompressible": 2.0, "spin_ten_turns": 0.12,
           "stretch_8x": 0.014, "stretch_8x_turning": 0.15, "stretch_8x_pulled": None}


def method_of(words):
    (method,) = runs.parse_method(words)
    return method


@pytest.fixture(scope="module")
def deciders(gimp_x):
    return runs.time_keys(str(gimp_x))[1]


@pytest.fixture
def survival(gimp_x, tmp_path, deciders):
    """A function survival(case, method="", program=gimp.x, longest=60) -> row of the table"""

    def run(case, method="stress_update=musl", program=gimp_x, longest=60):
        return st.survival(case, method_of(method), tmp_path, "run", str(program), deciders, longest)

    return run


def hard(name):
    return st.read_case(INPUTS / "hard" / f"{name}.nml")


# ---------------------------------------------------------------------------------------- the cases


def test_every_case_has_its_bound():
    assert {path.stem for path in HARD} == set(DEFAULT) | {"inverted_start"}


@pytest.mark.parametrize("name", DEFAULT)
def test_default_method_on_a_hard_case(name, survival, tmp_path):
    """Whole runs, about 2 s in all; the books close whatever happens"""
    row = survival(hard(name))
    if DEFAULT[name] is None:
        assert row["verdict"] == "fails" and "it has left the grid" in row["reason"] and 0 < row["reached"] < 1
    else:
        assert row["verdict"] == "survives" and row["error"] <= DEFAULT[name], row
        assert row["energy_gain"] < 0.1 and row["reached"] == pytest.approx(1.0, abs=1e-12)
    assert gf.summary(tmp_path / "run.vtkhdf")["energy_residual"] < 1e-12


def test_inverted_start_is_refused_and_that_is_right(survival):
    assert survival(hard("inverted_start"))["verdict"] == "survives"


@pytest.mark.parametrize("text, message", [("! hard: probe1_x lately, answer 0, scale 1\n", "must say what it asks"), ("", "must say what it asks"),
                                           ('! hard: refused, "no"\n! hard: dt last, answer 0, scale 1\n', "must say what it asks")])
def test_a_case_that_asks_nothing_sensible(text, message, tmp_path):
    (tmp_path / "x.nml").write_text(text + "&time end = 1.0 /\n")
    with pytest.raises(gf.GimpError, match=message):
        st.read_case(tmp_path / "x.nml")


def test_statistics():
    time = np.array([0.0, 1.0, 4.0])
    column = np.array([0.0, 2.0, 4.0])
    assert st.statistic("mean", column, time) == pytest.approx(10/4)  # over time, not over rows
    assert st.statistic("fall", -column, time) == 4.0 and st.statistic("max", -column, time) == 0.0
    question = st.Question("a", "last", "first", "first")
    assert question.error({"a": np.array([4.0, 0.0, 3.0]), "time": time}) == 0.25
    assert math.isnan(question.error({"time": time}))


# ---------------------------------------------------------------------------------------- how runs end


def test_a_clean_failure_is_told_with_its_message(survival):
    """Hats with USL: a known failure (docs/verification.md, Rigid motion)"""
    row = survival(hard("particle_on_node"), f"{LINEAR} stress_update=usl")
    assert row["verdict"] == "fails" and "inverted" in row["reason"] and row["reached"] < 0.5


def test_a_wrong_answer_is_a_silent_failure(survival):
    case = hard("lone_particle")
    row = survival(st.Case(case.name, case.text, (st.Question("probe1_x", "last", "12.5", "10"), st.Question("probe1_y", "last", "60", "5"))))
    assert row["verdict"] == "silent" and row["error"] == pytest.approx(10.5) and "wrong by 10.5 scales" in row["reason"]
    row = survival(st.Case(case.name, case.text, (st.Question("no_such_column", "last", "0", "1"),)))
    assert row["verdict"] == "silent"
    row = survival(st.Case(case.name, case.text, (), "it must be refused"))
    assert row["verdict"] == "silent"


def test_energy_from_nothing_is_a_silent_failure():
    zeros = np.zeros(3)
    table = {name: zeros for name in ("stored_energy", "external_work", "reaction_work", *st.DISSIPATION)}
    assert st.energy_gain({**table, "kinetic_energy": np.array([2.0, 26.0, 1.0])}) == 12.0
    worked = {**table, "kinetic_energy": np.array([0.0, 3.0, 4.0]), "external_work": np.array([0.0, 3.0, 4.0])}
    assert st.energy_gain(worked) == 0.0


def test_a_run_that_burst_is_warned_of(survival, tmp_path):
    """Hats with USF gain energy where the column creeps over an edge, twenty times what there is, and stay bounded all the same"""
    row = survival(hard("edge_creep"), f"{LINEAR} stress_update=usf")
    assert row["verdict"] == "warned" and row["energy_gain"] > 10 and "gained" in row["reason"]
    assert gf.summary(tmp_path / "run.vtkhdf")["energy_drift"] > 0.5
    survival(hard("edge_creep"))
    assert "warning" not in (tmp_path / "run.log").read_text()


@pytest.mark.parametrize("script, verdict, words", [
    ("kill -SEGV $$", "crashes", "exit code -11"), ("echo 'Backtrace for this error:' >&2; exit 1", "crashes", "Backtrace"),
    ("exec sleep 30", "hangs", "stopped after 0.5 s"), ("echo 'gimp.x: the run failed: step 3, too bad' >&2; exit 1", "fails", "step 3, too bad"),
    ("printf 'gimp.x: 1 mistake\\n  line 2: &method: no sense\\n' >&2; exit 2", "refused", "no sense"),
    ("printf 'gimp.x: 1 mistake\\n  line 2: basis; planned, not built yet\\n' >&2; exit 2", "not in this build", "planned")])
def test_other_ends(survival, tmp_path, script, verdict, words):
    program = tmp_path / "program"
    program.write_text(f"#!/bin/sh\ncat > /dev/null\n{script}\n")
    program.chmod(0o755)
    row = survival(hard("lone_particle"), program=program, longest=0.5)
    assert row["verdict"] == verdict and words in row["reason"]


# ---------------------------------------------------------------------------------------- the largest stable step


@pytest.mark.parametrize("scheme, limit", [("usl", 2/math.sqrt(7)), ("musl", math.sqrt(3))])
def test_stable_step_of_the_bar_is_the_known_one(gimp_x, tmp_path, deciders, scheme, limit):
    """Hats, two particles a cell at its quarters, wave number k, s = sin(kh/2): M^-1 K has 4 s^2 (c/h)^2, the smoothing P has 1 - 3/4 s^2, and
    dt^2 K/M W <= 4 with W = 2 - P for USL, P for MUSL (docs/method.md). Worst at s = 1 and s^2 = 2/3. The search is sharp to 2 %, and a
    bar has no endless waves: 3 %."""
    (bar,) = st.limits(["bar"])
    row = st.largest_stable(bar, method_of(f"{LINEAR} stress_update={scheme}"), tmp_path, "bar", str(gimp_x), deciders, 60)
    assert row["verdict"] == "found" and row["limit"] == pytest.approx(limit, rel=0.03)


@pytest.mark.parametrize("edge, expected", [(1.234, 1.234), (0.05, 0.05), (99.0, None), (0.0, 0.0)])
def test_the_search_finds_the_edge(monkeypatch, edge, expected):
    asked = []
    (bar,) = st.limits(["bar"])
    monkeypatch.setattr(st, "run", lambda text, *others: (text, None))
    monkeypatch.setattr(st, "is_stable", lambda limit, text, problem: (asked.append(step_of(text)/limit.unit), asked[-1] <= edge)[1])
    row = st.largest_stable(bar, method_of(f"{LINEAR} stress_update=usl"), None, "", "", {}, 0)
    assert row["limit"] == pytest.approx(expected, rel=0.021) if expected is not None else row["limit"] >= st.LARGEST
    assert len(asked) <= 16 and row["limit"] <= edge


def step_of(text):
    return next(group.values()["step"][0] for group in namelist.groups(text) if group.name == "time")


def test_growth_of_energy_is_not_stable(tmp_path, gimp_x, deciders):
    """The free block with its energy counted at a third of what it is: the same run is stable or not by its energy alone"""
    (block,) = st.limits(["block"])
    output, problem = st.run(st.at_courant(block, 0.3), tmp_path, "block", str(gimp_x), 60)
    table = gf.history(output)
    energy = table["kinetic_energy"] + table["stored_energy"]
    assert energy[0] == pytest.approx(block.energy, rel=0.02) and energy.max() < 1.1*block.energy
    assert st.is_stable(block, output, problem)
    assert not st.is_stable(st.Limit(block.name, block.text, block.unit, block.energy/3), output, problem)


# ---------------------------------------------------------------------------------------- a study


def test_a_study_goes_on_where_it_was_and_is_drawn(gimp_x, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("GIMP_X", str(gimp_x))
    (tmp_path / "methods.txt").write_text(f"[hats]\nlinear: {LINEAR} stress_update=usl|musl\n[others]\nof the future: no_such_key=1\n"
                                          "too much: flip_fraction=2\n")
    words = ["--methods", str(tmp_path / "methods.txt"), "--cases", "lone_particle,particle_on_node,inverted_start", "--courant", "none",
             "--csv", str(tmp_path / "s.csv"), "--table", str(tmp_path / "s.md")]
    assert stability.main([*words, "--only", "hats"]) == 0
    assert "6 to run, 0 in" in capsys.readouterr().err
    assert stability.main([*words, "--jobs", "2"]) == 0
    told = capsys.readouterr()
    assert "6 to run, 6 in" in told.err
    rows = {(row["label"], row["case"]): row for row in stability.read_rows(tmp_path / "s.csv")}
    assert len(rows) == 12
    assert rows["linear usl", "particle_on_node"]["verdict"] == "fails" and rows["linear musl", "particle_on_node"]["verdict"] == "survives"
    assert rows["of the future", "lone_particle"]["verdict"] == "not in this build"
    assert rows["too much", "lone_particle"]["verdict"] == "refused"
    text = (tmp_path / "s.md").read_text()
    assert text in told.out
    assert "| **hats** |" in text and re.search(r"^\| linear usl \| [^|]+ \| fails 0\.\d+ \| yes \|$", text, re.MULTILINE)
    assert "- particle_on_node, fails: linear usl: step " in text and "(the particle is inverted)" in text
    assert_drawn(tmp_path / "s.png", width=600, height=300)

    monkeypatch.setattr(st, "TOO_WRONG", 1e-3)  # a silent failure ends the study with code 1
    assert stability.main(["--methods", f"{LINEAR} stress_update=musl", "--cases", "particle_on_node", "--courant", "none",
                           "--csv", str(tmp_path / "other.csv")]) == 1
    assert "| silent 0.0" in capsys.readouterr().out


def test_momentum_lost_at_free_surfaces_is_told(survival, tmp_path):
    """The dual domain method sends force to nodes that its hats give no mass (docs/method.md): a block in flight is stopped by it"""
    row = survival(hard("particle_on_node"), "basis=ddmp transfer=flip flip_fraction=1 stress_update=musl")
    assert row["error"] > 1.0 and gf.summary(tmp_path / "run.vtkhdf")["cut_nodes"] > 1000
    assert "nodes with no mass to speak of took" in (tmp_path / "run.log").read_text()
    case = hard("particle_on_node")
    wrong = st.Case(case.name, case.text, (st.Question("error_rms", "last", "0", "0.1"),))
    assert survival(wrong, "basis=ddmp transfer=flip flip_fraction=1 stress_update=musl")["verdict"] == "warned"

"""The benchmark runner: its plan, tables, resuming and skipping on made-up results, and one tiny run from end to end."""
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from conftest import INPUTS, REPOSITORY

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")
BENCHMARKS = REPOSITORY / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import bench_cases as cases  # noqa: E402
import bench_machine as machine  # noqa: E402
import bench_measure as measuring  # noqa: E402
import bench_report as reporting  # noqa: E402
import gimp_files  # noqa: E402
import namelist  # noqa: E402
import run as benchmark  # noqa: E402

SCENES = sorted((INPUTS / "benchmark").glob("*.nml"))
TOLD = {"processor": "Some CPU AVX2", "processors": 2, "caches": "L1d 32K", "virtual": False, "compiler_version": "GNU Fortran 12", "flags": "-O3"}
ROOFLINE = [{"what": "fma", "threads": 1, "dp_gflops": 100.0, "dp_median": 90.0, "sp_gflops": 200.0, "sp_median": 190.0, "when": "before"},
            {"what": "bandwidth_dram", "threads": 1, "triad_gbs": 10.0, "triad_median": 9.0, "update_gbs": 20.0, "update_median": 19.0, "when": "before"},
            {"what": "core_to_core", "threads": 2, "farthest_best_ns": 80.0, "farthest_median_ns": 90.0, "placement": "near", "when": "before"}]


def made_up(case="cube3d", basis="ugimp", transfer="flip", bits=64, threads=1, particles=262144, **other):
    """A line of the results as a measurement leaves it"""
    m = cases.Measurement(case, basis, transfer, bits, threads, particles)
    line = {**dataclasses.asdict(m), "asked_particles": particles, "ns_per_particle_step": 100.0, "reference_ns": 90.0, "ratio": 0.9,
            "ratio_spread": [0.8, 1.0], "bytes_per_particle": 368.0, "state_bytes_per_particle": 144.0, "steps": 40, "energy_difference": 2e-14,
            "pairs": 5, "reference": m.variant, "floor": m.floor, "shares": {"particles": 0.9, "grid": 0.07, "sort": 0.03}, "busy": 1.0,
            "peak_bytes": 400.0*particles + 1e8, "compiler": "gfortran", "flags": "-O3", "commit": "abc", "plastic_dissipation": 0.0}
    if threads > 1:
        line.update(scaling=1.9, scaling_spread=[1.8, 2.0], round_trip_ns=[80.0, 230.0])
    return {**line, **other}


# ------------------------------------------------------------------------------------------------- scenes and plan


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_benchmark_scene_runs(scene, run_scene, tmp_path):
    """Every benchmark scene, made small, closes its energy book"""
    side = 8
    text = cases.block_scene(scene.read_text(), side, "ugimp", 20, 20)
    run = run_scene(text, tmp_path).succeeded()
    assert run.summary["steps"] == 20 and abs(run.summary["energy_residual"]) < 1e-12  # round-off, as for all scenes
    assert run.summary["particles"] == cases.count_of(side, 2 if scene.stem.endswith("2d") else 3)
    assert (run.history["plastic_dissipation"][-1] > 0.0) == (scene.stem == "mixed3d")


def test_there_is_a_scene_for_each_case():
    assert {path.stem: path for path in SCENES} == cases.SCENES


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_scene_has_the_step_of_the_reference(scene):
    groups = {g.name: g.values() for g in namelist.groups(scene.read_text())}
    side = round(0.5/groups["grid"]["spacing"][0])
    assert groups["time"]["step"][0] == pytest.approx(cases.fixed_step(side), rel=1e-12)
    assert groups["output"]["name"] == [scene.stem]


@pytest.mark.parametrize("particles, dimension, side", [(32768, 3, 16), (262144, 3, 32), (262144, 2, 256), (2097152, 2, 724), (8388608, 3, 102), (1, 2, 2)])
def test_block_of_about_so_many_particles(particles, dimension, side):
    assert cases.side_of(particles, dimension) == side and side % 2 == 0


@pytest.mark.parametrize("particles, steps", [(4096, 200), (32768, 200), (262144, 40), (2097152, 20), (8388608, 20)])
def test_steps_are_whole_sorting_intervals(particles, steps):
    assert cases.steps_for(particles) == steps


def test_plan_holds_each_measurement_once_and_the_important_first():
    plan = cases.plan(tuple(cases.SCENES), cases.SIZES)
    assert len(set(plan)) == len(plan)
    assert {m.case for m in plan} == set(cases.SCENES) and {m.particles for m in plan} == set(cases.SIZES)
    assert [m.basis for m in plan if m.transfer == "mls"].count("bspline2") == sum(m.transfer == "mls" for m in plan)
    assert {(m.basis, m.transfer) for m in plan if m.case == "mixed3d"} == {("ugimp", "flip")}
    small = [m for m in plan if m.particles < cases.LARGE]
    assert plan[:len(small)] == small
    for part in (small, plan[len(small):]):
        assert [(m.bits, m.threads) for m in part[::len(part)//4]] == [(64, 1), (64, 2), (32, 1), (32, 2)]


def test_reference_of_a_measurement():
    def variant(*words):
        m = cases.Measurement(*words, 262144)
        return m.variant, m.same_step, m.floor

    assert variant("cube3d", "bspline2", "flip", 64, 1) == ("flip3d_64", True, 0.75)
    assert variant("square2d", "linear", "flip", 32, 2) == ("linear2d_32", True, 0.75)
    assert variant("cube3d", "bspline2", "mls", 64, 1) == ("apic3d_64", True, 0.75)
    assert variant("cube3d", "ugimp", "apic", 64, 1) == ("apic3d_64", False, None)
    assert variant("mixed3d", "ugimp", "flip", 64, 1) == ("ugimp3d_64", False, 0.55)


# ------------------------------------------------------------------------------------------------- tables


def test_shares_of_the_limit():
    line = measuring.with_shares_of_limit(made_up(), ROOFLINE)
    assert line["memory_share"] == pytest.approx(2*144/20.0/100.0)  # bytes over GB/s are ns
    assert line["flop_share"] == pytest.approx(2024/100.0/100.0)
    assert measuring.with_shares_of_limit(made_up(basis="cpgimp"), ROOFLINE)["flop_share"] is None
    assert measuring.with_shares_of_limit(made_up(), [])["memory_share"] is None


def test_bandwidth_of_several_samples_is_their_median():
    samples = [{"what": "bandwidth_dram", "threads": 2, "update_gbs": value} for value in (40.0, 110.0, 42.0)]
    assert machine.limits(samples, 2)["memory"] == 42.0 and machine.limits(samples, 1)["memory"] is None


def test_memory_slope_is_between_smallest_and_largest():
    lines = [made_up(particles=n) for n in (262144, 2097152, 524288)] + [made_up(basis="linear", particles=32768, peak_bytes=None)]
    slope, = measuring.memory_slopes(lines)
    assert slope["slope"] == pytest.approx(400.0) and (slope["from"], slope["to"]) == (262144, 2097152)


def test_document_holds_every_kind_of_table():
    lines = [made_up(particles=n) for n in (32768, 262144)] + [made_up(threads=2), made_up(bits=32), made_up(basis="cpgimp", ratio=0.5), made_up(basis="linear", busy=0.4),
             made_up("mixed3d", ratio=0.6, energy_difference=None)]
    text = reporting.document(lines, ROOFLINE, TOLD, ["cube3d bspline2: planned"])
    for words in ("One thread", "By size", "Threads", "Single precision", "Memory", "The machine", "Not measured", "80-230", "other scene", "Noise", "starved"):
        assert words in text, words
    assert text.count("**below**") == 1
    for block in text.split("\n\n"):
        rows = [row for row in block.splitlines() if row.startswith("|")]
        assert len({row.count("|") for row in rows}) <= 1, block  # every row has as many cells as its heading


def test_equal_reasons_are_told_once():
    found = [(cases.Measurement("cube3d", basis, "flip", 32, 1, 32768), "no gimp_sp.x") for basis in cases.BASES]
    assert reporting.grouped(found) == ["cube3d linear flip single, cube3d ugimp flip single, cube3d cpgimp flip single, cube3d bspline2 flip single, cube3d cpdi flip single: no gimp_sp.x"]


def test_picture_and_csv(tmp_path):
    lines = [made_up(case, particles=n) for case in ("cube3d", "square2d") for n in (32768, 262144)]
    reporting.draw(tmp_path / "p.png", lines, ROOFLINE)
    assert 5000 < (tmp_path / "p.png").stat().st_size < 200_000
    reporting.write_csv(tmp_path / "t.csv", lines, ROOFLINE)
    rows = (tmp_path / "t.csv").read_text().splitlines()
    assert rows[0].split(",") == list(reporting.COLUMNS) and len(rows) == 5


def test_publishing_replaces_the_generated_part_only(tmp_path, monkeypatch):
    page = tmp_path / "performance.md"
    page.write_text(f"before\n{reporting.BEGIN}\nold\n{reporting.END}\nafter\n")
    (tmp_path / "plot.png").write_bytes(b"picture")
    monkeypatch.setattr(reporting, "DOCUMENT", page)
    monkeypatch.setattr(reporting, "FIGURE", tmp_path / "figures" / "performance.png")
    for text in ("new \\1", "newer"):
        reporting.publish(text, tmp_path / "plot.png")
    assert page.read_text() == f"before\n{reporting.BEGIN}\n\nnewer\n\n{reporting.END}\nafter\n"
    assert (tmp_path / "figures" / "performance.png").read_bytes() == b"picture"
    assert reporting.BEGIN in (REPOSITORY / "docs" / "performance.md").read_text()


# ------------------------------------------------------------------------------------------------- resuming, skipping


def test_results_are_kept_line_by_line(tmp_path):
    results = measuring.Results(tmp_path)
    results.add(made_up())
    with open(tmp_path / "measurements.jsonl", "a") as file:
        file.write('{"case": "cube3d", "cut')  # killed while it wrote
    again = measuring.Results(tmp_path, resume=True)
    m = cases.Measurement("cube3d", "ugimp", "flip", 64, 1, 262144)
    assert again.lines == [made_up()] and again.finished(m, 5) and not again.finished(m, 6)
    assert not again.finished(dataclasses.replace(m, threads=2), 1)
    assert again.keep_only(flags="-O3") == 0 and again.keep_only(flags="-O2") == 1 and not again.lines
    results.add(made_up())
    assert not measuring.Results(tmp_path).lines and (tmp_path / "measurements.jsonl.previous").exists()


def test_a_refused_scene_is_skipped_with_the_words_of_the_program(gimp_x, tmp_path):
    text = cases.block_scene(cases.SCENES["square2d"].read_text(), 4, "linear", 20, 20, "apic")
    with pytest.raises(measuring.Skipped, match="gimp.x refuses: line .*apic"):
        measuring.admit(str(gimp_x), text, 64, tmp_path)


def test_what_does_not_fit_is_skipped(gimp_x, tmp_path, monkeypatch):
    text = cases.block_scene(cases.SCENES["square2d"].read_text(), 4, "ugimp", 20, 20)
    measuring.admit(str(gimp_x), text, 64, tmp_path)
    monkeypatch.setattr(machine, "available_memory", lambda: 10**8)
    with pytest.raises(measuring.Skipped, match="GB of memory"):
        measuring.admit(str(gimp_x), text, 64, tmp_path)


def test_a_missing_program_is_skipped(tmp_path):
    with pytest.raises(measuring.Skipped, match="no gimp_sp.x"):
        measuring.measure(cases.Measurement("cube3d", "ugimp", "flip", 32, 1, 512), 1, tmp_path, {}, tmp_path)


@pytest.mark.parametrize("words, complaint", [(["--all", "--bases", "cpdi9"], "'cpdi9' is none of linear"), (["--threads", "1,2"], "one number"),
                                              (["--all", "--threads", "0"], "no list of positive"), (["--pairs", "0"], "must be positive")])
def test_arguments_that_are_not_understood(words, complaint, capsys):
    with pytest.raises(SystemExit):
        benchmark.parse_arguments(words)
    assert complaint in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------- end to end


@pytest.fixture
def build_folder(gimp_x, monkeypatch):
    """The build folder of the program that is tested"""
    folder = gimp_x.parent.parent
    if not (folder / "CMakeCache.txt").exists():
        pytest.skip("the program does not stand in its build folder")
    monkeypatch.delenv("GIMP_X", raising=False)
    return folder


TINY = ["--all", "--quick", "--cases", "square2d", "--bases", "linear", "--transfers", "flip,apic", "--precisions", "double", "--threads", "1",
        "--sizes", "256", "--steps", "20"]


def test_all_cases_from_end_to_end(build_folder, tmp_path, capsys):
    """Measured, skipped, and not measured again; nothing is asked of the times but that they are there"""
    words = [*TINY, "--build", str(build_folder), "--results", str(tmp_path)]
    assert benchmark.main(words) == 0
    told = capsys.readouterr()
    lines = [json.loads(text) for text in (tmp_path / "measurements.jsonl").read_text().splitlines()]
    line, = lines
    assert (line["basis"], line["transfer"], line["particles"], line["steps"]) == ("linear", "flip", 256, 20)
    assert line["ns_per_particle_step"] > 0 and line["reference_ns"] > 0 and 0.5 < sum(line["shares"].values()) <= 1.0 + 1e-9
    # both programs add the same numbers in another order: round-off of 256 particles over 20 steps, with room
    assert line["energy_difference"] < 1e-11
    assert "square2d linear apic double: gimp.x refuses" in told.out and "skipped" in told.err
    assert {"table.md", "table.csv", "plot.png", "roofline.jsonl"} <= {path.name for path in tmp_path.iterdir()}
    before = (tmp_path / "measurements.jsonl").read_bytes()
    assert benchmark.main([*words, "--resume"]) == 0
    assert "2 measurements, 1 of them finished" in capsys.readouterr().err
    assert (tmp_path / "measurements.jsonl").read_bytes() == before


def test_interrupted_run_keeps_what_is_finished(build_folder, tmp_path):
    """Ctrl-C after the first measurement: its line, the tables, and exit code 130"""
    words = [*TINY, "--sizes", "256,1000000", "--transfers", "flip", "--steps", "60", "--build", str(build_folder), "--results", str(tmp_path)]
    child = subprocess.Popen([sys.executable, str(BENCHMARKS / "run.py"), *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
                             preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))  # a test run in the background inherits "ignore"
    deadline = time.monotonic() + 120
    while not (tmp_path / "measurements.jsonl").exists() and child.poll() is None and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(child.pid, signal.SIGINT)
    assert child.wait(60) == 130
    assert len((tmp_path / "measurements.jsonl").read_text().splitlines()) == 1 and (tmp_path / "table.md").exists()


def test_a_build_compared_with_itself_does_not_differ(build_folder, capsys):
    code = benchmark.main(["--compare-builds", str(build_folder), str(build_folder / "bin" / "gimp.x"), "--cases", "square2d", "--bases", "ugimp",
                           "--transfers", "flip", "--steps", "10"])
    line = capsys.readouterr().out.splitlines()[-1].split()
    assert code == 0 and line[:4] == ["square2d", "ugimp", "flip", "10"] and [float(word) for word in line[4:7]] == [0.0]*3 and line[7:] == ["the", "same"]


def test_method_cost_tells_refused_methods_and_writes_its_table(tmp_path, gimp_x):
    done = subprocess.run([sys.executable, str(BENCHMARKS / "method_cost.py"), "--case", "square2d", "--particles", "1024", "--pairs", "1", "--steps", "4",
                           "--methods", "cpdi: basis=cpdi stress_update=usl; tents: basis=linear transfer=apic", "--markdown", str(tmp_path / "cost.md")],
                          capture_output=True, text=True, env={**os.environ, "GIMP_X": str(gimp_x)})
    assert done.returncode == 0, done.stderr
    assert "tents: gimp.x refuses" in done.stderr and "diverges with basis" in done.stderr
    heading, _, line = (tmp_path / "cost.md").read_text().splitlines()
    assert "1024 particles of square2d" in heading
    assert line.startswith("| cpdi | ") and 0.1 < float(line.split("|")[2]) < 100.0


def test_meshes_are_measured_beside_the_grid(tmp_path, gimp_x):
    done = subprocess.run([sys.executable, str(BENCHMARKS / "meshes.py"), "--cases", "quad4", "--bases", "linear,bspline2", "--cells", "6,4", "--steps", "4,2",
                           "--pairs", "1", "--markdown", str(tmp_path / "meshes.md")], capture_output=True, text=True, env={**os.environ, "GIMP_X": str(gimp_x)})
    assert done.returncode == 0, done.stderr
    assert "bspline2 in 2D: gimp.x refuses" in done.stderr  # splines need a grid
    heading, _, line = (tmp_path / "meshes.md").read_text().splitlines()
    cells = [cell.strip() for cell in line.split("|")[1:-1]]
    assert cells[:3] == ["quad4, 4 nodes", "linear", "144"] and len(cells) == heading.count("|") - 1
    assert all(float(cells[k]) > 0.0 for k in (3, 5))  # how large is a matter of the machine
    visits, leaves, bound = map(float, cells[8:])
    assert visits >= 1.0 and bound == pytest.approx(1.0 + 1.2*leaves, abs=2e-4)  # four digits are printed

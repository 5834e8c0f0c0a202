"""What ranks send is what the model of benchmarks/rank_model.py says: every message, and every byte where no particle has drifted."""
import sys

import pytest

from conftest import INPUTS, MPIRUN, REPOSITORY, runner

pytest.importorskip("h5py")
sys.path.insert(0, str(REPOSITORY / "benchmarks"))

import bench_cases as cases  # noqa: E402
import namelist  # noqa: E402
import rank_counts as counting  # noqa: E402
import rank_model as model  # noqa: E402

STEPS = 3


def square(side):
    """The square of the benchmarks"""
    text = cases.block_scene((INPUTS / "benchmark" / "square2d.nml").read_text(), side, "bspline2", STEPS, 0)
    return namelist.set_key(text, "method.stress_update", "musl")


# scene, dimension, basis, pads sent: once before the first step, then in each pass of a step that gives
@pytest.mark.parametrize("text, dim, basis, passes", [(counting.cube(16, "usl", steps=STEPS), 3, "ugimp", 1 + STEPS),
                                                      (counting.cube(8, "fmpm(3)", steps=STEPS), 3, "ugimp", 1 + 3*STEPS),
                                                      (square(64), 2, "bspline2", 1 + 2*STEPS)], ids=["cube-usl", "cube-fmpm", "square-musl"])
def test_messages_and_bytes(gimp_x, gimp_mpi_x, tmp_path, text, dim, basis, passes):
    saved = runner(gimp_x)(text + f"\n&restart\n  every_steps = {STEPS}\n/\n", tmp_path).succeeded()
    checkpoint = tmp_path / f"{saved.output.stem}.checkpoint.h5"
    layouts = {ranks: counting.layout_of(checkpoint, ranks, dim, basis) for ranks in (2, 3, 7)}
    for ranks, layout in layouts.items():
        shares = model.shares_of(layout)
        told = runner(*MPIRUN, "-n", ranks, gimp_mpi_x)(text, tmp_path).succeeded().summary
        assert told["state_hash"] == saved.summary["state_hash"]
        assert told["pad_messages"] == passes*sum(share.messages for share in shares)
        assert told["pad_bytes"] == 8*passes*sum(share.plain for share in shares)
        assert told["halo_share"] == pytest.approx(max(share.ghosts/share.blocks for share in shares), rel=1e-12)


@pytest.mark.parametrize("blocks, ranks, first", [([1, 1, 1, 1], 2, [0, 2, 4]), ([5, 1, 1, 1], 2, [0, 1, 4]), ([1, 1, 1, 5], 3, [0, 2, 3, 4]), ([7], 3, [0, 0, 1, 1])])
def test_cuts(blocks, ranks, first):
    """Cuts lie at the block that is nearest to an equal share; a block larger than the shares leaves a rank without any"""
    assert list(model.cut_blocks(blocks, ranks)) == first


def test_every_slot_is_booked_once():
    """All ranks together count every slot in sums, each once; what one rank has alone it gets from nobody"""
    for ranks in (1, 2, 5):
        shares = model.shares_of(model.box_layout((4, 3, 3), ranks))
        assert sum(share.booked for share in shares) == 6*5*5
        assert sum(share.blocks for share in shares) == 36
    alone = model.share_of(model.box_layout((4, 3, 3), 1), 0)
    assert (alone.messages, alone.plain, alone.ghosts) == (0, 0, 0)

"""What ranks send each other, worked out from where the blocks lie: pads of blocks, messages, ghosts, booked slots.

A layout is a list of blocks with their work, cut into ranks along the Morton curve. For every rank the model finds who must give it which
part of which pad, by the rules of src/transfer/gimp_borders.f90, but from the blocks of all ranks at once and without sending
anything. Without periodic sides and planes of symmetry (and with supports that stay inside pads) the program must count the same
messages exactly, and the same bytes but for pads of blocks with drifted particles: `plain` holds for none, `drifted` for all.
"""
from dataclasses import dataclass

import numpy as np

EDGE = {1: (64, 1, 1), 2: (8, 8, 1), 3: (4, 4, 4)}  # nodes of a block along each axis
WIDTH = {"linear": 2, "bspline3": 4, "ddmp": 4}  # nodes of a support along an axis; 3 of all others
NODE_WORDS = {64: 8, 32: 4}  # 8 fields in words of 64 bits, by the bits of a real
WORK_OF_PAD = 8  # work of a block beside its chunks of 8 particles
DRIFT = 1
REACH = 2  # blocks whose pads may have nodes in common


def morton(at):
    """Keys of blocks: their coordinates (n, 3) interleaved bit by bit, x lowest"""
    key = np.zeros(len(at), np.int64)
    for axis in range(3):
        part = at[:, axis].astype(np.int64) + 2**19
        part = (part | part << 32) & 0x1F00000000FFFF
        part = (part | part << 16) & 0x1F0000FF0000FF
        part = (part | part << 8) & 0x100F00F00F00F00F
        part = (part | part << 4) & 0x10C30C30C30C30C3
        part = (part | part << 2) & 0x1249249249249249
        key |= part << axis
    return key


def cut_blocks(work, ranks):
    """The first block of each rank (ranks + 1 numbers), blocks in the order of their keys; as gimp_cuts does it"""
    before = np.concatenate(([0], np.cumsum(work)))
    total = int(before[-1])
    first = [0]
    for k in range(1, ranks):
        aim = total//ranks*k + total % ranks*k//ranks
        n = int(np.searchsorted(before, aim))
        if n > 0 and before[n] - aim > aim - before[n - 1]:
            n -= 1
        first.append(max(first[-1], n))
    return np.array([*first, len(work)])


@dataclass
class Layout:
    """Blocks in the order of their keys and the ranks they belong to"""
    at: np.ndarray  # (block, 3)
    key: np.ndarray  # (block)
    first: np.ndarray  # (ranks + 1) first block of each rank
    dim: int
    width: int  # nodes of a support along an axis

    @property
    def ranks(self):
        return len(self.first) - 1

    @property
    def edge(self):
        return np.array(EDGE[self.dim])

    @property
    def pad(self):
        """First and last node of a pad along each axis, from the first node of its block"""
        used = np.arange(3) < self.dim
        low = np.where(used, -DRIFT, 0)
        return low, np.where(used, low + self.edge + self.width - 2 + 2*DRIFT, 0)

    def owner(self, at):
        """The rank that has a block at each place (n, 3); -1 where there is none"""
        key = morton(at)
        place = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        rank = np.searchsorted(self.first, place, side="right") - 1
        return np.where(self.key[place] == key, rank, -1)

    def around(self, reach):
        """Offsets of the blocks up to so far away, x fastest"""
        d = range(-reach, reach + 1)
        return np.array([(x, y, z) for z in (d if self.dim > 2 else [0]) for y in (d if self.dim > 1 else [0]) for x in d])


def make_layout(at, work, ranks, dim, basis="ugimp"):
    """Blocks at (n, 3) with their work, cut for so many ranks"""
    key = morton(at)
    order = np.argsort(key)
    return Layout(at[order], key[order], cut_blocks(np.asarray(work)[order], ranks), dim, WIDTH.get(basis, 3))


def box_layout(sides, ranks, basis="ugimp"):
    """A box of full blocks; the length of `sides` is the dimension"""
    sides = list(sides)
    at = np.indices((*sides, 1, 1)[:3]).reshape(3, -1).T
    return make_layout(at, np.ones(len(at), np.int64), ranks, len(sides), basis)


def _distinct(at):
    """Places without repeats, in the order of their keys, and those keys"""
    key, first = np.unique(morton(at), return_index=True)
    return at[first], key


@dataclass
class Share:
    """What one rank has and gets in one pass"""
    blocks: int
    ghosts: int  # blocks of others that it knows
    slots: int
    booked: int  # slots that it counts in sums
    messages: int  # that it gets
    parts: int
    plain: int  # words of 64 bits that it gets, without drifted particles
    drifted: int  # and where all blocks have some
    border: int  # blocks that others have as ghosts


def share_of(layout, rank, node_words=8):
    """The share of a rank, from the blocks of all"""
    own = layout.at[layout.first[rank]:layout.first[rank + 1]]
    if not len(own):
        return Share(0, 0, 0, 0, 0, 0, 0, 0, 0)
    near, far = layout.around(1), layout.around(REACH)
    around, _ = _distinct((own[:, None] + far).reshape(-1, 3))
    owner = layout.owner(around)
    ghosts = around[(owner >= 0) & (owner != rank)]
    giver = owner[(owner >= 0) & (owner != rank)]
    slots, slot_key = _distinct((own[:, None] + near).reshape(-1, 3))
    here = layout.owner((slots[:, None] + near).reshape(-1, 3)).reshape(len(slots), -1)
    by = np.take_along_axis(here, np.argmax(here >= 0, axis=1)[:, None], axis=1)[:, 0]  # who has the first block around a slot
    booked = by == rank
    low, high = _parts(layout, ghosts, rank, slot_key[booked])
    wanted = np.all(low <= high, axis=1)
    low, high, giver = low[wanted], high[wanted], giver[wanted]
    pad_low, pad_high = layout.pad
    used = np.arange(3) < layout.dim
    full = np.prod(high - low + 1, axis=1)
    inner = np.prod(np.maximum(0, np.minimum(high, pad_high - used) - np.maximum(low, pad_low + used) + 1), axis=1)
    seen = layout.owner((own[:, None] + far).reshape(-1, 3)).reshape(len(own), -1)
    sees = np.any((seen >= 0) & (seen != rank), axis=1)
    return Share(len(own), len(ghosts), len(slots), int(booked.sum()), len(np.unique(giver)), len(low), int(len(low) + node_words*inner.sum()),
                 int(len(low) + node_words*full.sum()), int(sees.sum()))


def _parts(layout, ghosts, rank, booked):
    """First and last node of each ghost's pad that matter: those that pads of own blocks have too, and those of booked slots"""
    pad_low, pad_high = layout.pad
    offset = layout.around(REACH)
    at = (ghosts[:, None] + offset).reshape(-1, 3)
    shape = (len(ghosts), len(offset), 1)
    own = (layout.owner(at) == rank).reshape(shape)
    counted = np.isin(morton(at), booked).reshape(shape)
    low, high = np.full((len(ghosts), 3), 99), np.full((len(ghosts), 3), -99)
    for chosen, first, last in ((own, offset*layout.edge + pad_low, offset*layout.edge + pad_high),
                                (counted, offset*layout.edge, offset*layout.edge + layout.edge - 1)):
        first, last = np.maximum(first, pad_low), np.minimum(last, pad_high)
        chosen = chosen & np.all(first <= last, axis=1)[:, None]
        low = np.minimum(low, np.where(chosen, first, 99).min(axis=1))
        high = np.maximum(high, np.where(chosen, last, -99).max(axis=1))
    return low, high


def shares_of(layout, sample=None, node_words=8):
    """Shares of all ranks, or of an even sample of so many"""
    ranks = range(layout.ranks) if sample is None or sample >= layout.ranks else np.unique(np.linspace(0, layout.ranks - 1, sample).astype(int))
    return [share_of(layout, int(r), node_words) for r in ranks]

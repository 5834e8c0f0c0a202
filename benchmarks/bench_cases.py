"""The standard cases: which scene, how large, with which settings, and which variant of the reference belongs to it."""
import math
from dataclasses import asdict, dataclass

from bench_paths import REPOSITORY
import namelist

SCENES = {name: REPOSITORY / "inputs" / "benchmark" / f"{name}.nml" for name in ("cube3d", "square2d", "mixed3d")}
DENSITY, YOUNG, POISSON = 1000.0, 1.0e6, 0.3  # of the reference; the scenes must agree
SIZES = (32768, 262144, 2097152, 8388608)
QUICK_SIZES = (4096, 32768)
LARGE = 4_000_000  # particles from which on a measurement takes minutes
BASES = ("linear", "ugimp", "cpgimp", "bspline2", "cpdi")
TRANSFERS = ("flip", "apic", "mls")
FLOORS = {"mixed3d": 0.55, "cpdi": 0.6}  # by case or basis: ratios below are a defect
FLOOR = 0.75

# Flops of a particle-step, sum-factorised, useful fields only; counted in reference/FINDINGS.md, section 2
FLOPS = {(3, "linear", "flip"): 836, (3, "ugimp", "flip"): 2024, (3, "bspline2", "flip"): 1916, (3, "bspline2", "mls"): 1466,
         (2, "linear", "flip"): 265, (2, "bspline2", "flip"): 464, (2, "bspline2", "mls"): 368}


@dataclass(frozen=True)
class Measurement:
    """One line of the results: what is run, not yet how fast it was"""
    case: str
    basis: str
    transfer: str
    bits: int  # 64 double, 32 single precision
    threads: int
    particles: int  # about so many

    @property
    def dimension(self):
        return 2 if self.case.endswith("2d") else 3

    @property
    def side(self):
        """Cells along a side of the block"""
        return side_of(self.particles, self.dimension)

    @property
    def variant(self):
        """The variant of the reference"""
        kind = "apic" if self.transfer in ("apic", "mls") else {"bspline2": "flip"}.get(self.basis, self.basis)
        return f"{kind}{self.dimension}d_{self.bits}"

    @property
    def same_step(self):
        """Whether the reference does the same step, so that energies must agree: its affine form is that of MLS on quadratic splines"""
        return self.case != "mixed3d" and (self.transfer == "flip" or (self.basis, self.transfer) == ("bspline2", "mls"))

    @property
    def affine_mass(self):
        """Mass of all particles where a transfer with affine parts is compared; None elsewhere"""
        return DENSITY*0.5**self.dimension if self.same_step and self.transfer != "flip" else None

    @property
    def floor(self):
        """The ratio below which it is a defect; none where the reference does another step"""
        return FLOORS.get(self.case, FLOORS.get(self.basis, FLOOR) if self.same_step else None)

    def key(self):
        """What makes two measurements the same"""
        return tuple(asdict(self).values())

    def words(self):
        precision = "double" if self.bits == 64 else "single"
        return (f"{self.case} {self.basis} {self.transfer} {precision}, {self.threads} thread{'s'*(self.threads > 1)}, "
                f"{count_of(self.side, self.dimension)} particles")


def side_of(particles, dimension=3):
    """Cells along a side of the block, an even number so that its faces lie on cell faces"""
    return max(2, 2*round((particles/2**dimension)**(1/dimension)/2))


def count_of(side, dimension=3):
    """Particles of a block of so many cells along a side"""
    return (2*side)**dimension


def fixed_step(side):
    """Step of the reference [s]: 0.2 h / c"""
    return 0.2*(0.5/side)/math.sqrt(YOUNG*(1 - POISSON)/((1 + POISSON)*(1 - 2*POISSON))/DENSITY)


def steps_for(particles, sort_every=20):
    """Time steps of a run: some ten million particle-steps, a whole number of sorting intervals, at least one, at most ten"""
    return sort_every*min(10, max(1, round(1.0e7/particles/sort_every)))


def block_scene(text, side, basis, steps, sort_every, transfer="flip"):
    """The scene with the settings of the reference"""
    step = fixed_step(side)
    for path, value in (("grid.spacing", 0.5/side), ("method.basis", basis), ("method.transfer", transfer),
                        ("method.flip_fraction", 1.0 if transfer == "flip" else 0.0), ("method.sort_every", sort_every),
                        ("time.step", step), ("time.end", steps*step), ("time.max_steps", steps), ("output.history_every", steps)):
        text = namelist.set_key(text, path, value)
    if basis == "cpgimp":
        text = namelist.set_key(text, "method.domain", "diagonal")  # the reference takes half lengths from F_kk
    if basis == "cpdi":
        text = namelist.set_key(text, "method.domain_limit", 2)  # it does not scale domains
    if basis == "bspline2":
        text = namelist.set_key(text, "method.spline_boundary", "ghost")  # and equal splines everywhere
    return text


def defaults_scene(text, side, steps):
    """The same cube with nothing said about the method, the step or what is written"""
    text = namelist.set_key(text, "grid.spacing", 0.5/side)
    text = namelist.remove_group(namelist.remove_group(text, "method"), "output")
    for key in [k for g in namelist.groups(text) if g.name == "time" for k in g.keys]:
        text = namelist.set_key(text, f"time.{key}", None)
    text = namelist.set_key(text, "time.end", 100*steps*fixed_step(side))
    text = namelist.set_key(text, "time.max_steps", steps)
    return namelist.set_key(text, "output.progress", "off")


def plan(cases, sizes, bases=BASES, transfers=TRANSFERS, bits=(64, 32), threads=(1, 2)):
    """All measurements, those first that matter most: the largest size comes last, double precision and one thread first

    MLS has a meaning on uniform splines only; mixed3d stands beside the uGIMP reference; that of CPDI is in space and FLIP.
    """
    found = [Measurement(case, basis, transfer, b, t, size)
             for b in bits for t in threads for size in sorted(sizes) for case in cases for basis in bases for transfer in transfers
             if (transfer != "mls" or basis == "bspline2") and (case != "mixed3d" or (basis, transfer) == ("ugimp", "flip"))
             and (basis != "cpdi" or (case, transfer) == ("cube3d", "flip"))]
    return sorted(found, key=lambda m: m.particles > LARGE)  # a stable sort

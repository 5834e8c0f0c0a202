"""The machine and the builds: compiler and flags of the product, the reference with the same ones, processors, memory, limits."""
import hashlib
import json
import os
import re
import resource
import shlex
import shutil
import statistics
import subprocess
from pathlib import Path

import bench_paths  # noqa: F401  finds postprocessing/
import gimp_files as gf

HERE = Path(__file__).resolve().parent


# ------------------------------------------------------------------------------------------------- the builds


def product_build(folder):
    """Compiler and flags of the product: from the build rules of a kernel file, else from the cache"""
    folder = Path(folder)
    cache = folder / "CMakeCache.txt"
    if not cache.exists():
        raise gf.GimpError(f"{folder} is no build folder of gimp.x (no CMakeCache.txt); name it with --build")
    entries = dict(re.findall(r"^([\w-]+):[^=\n]*=(.*)$", cache.read_text(), re.MULTILINE))
    kind = entries.get("CMAKE_BUILD_TYPE", "")
    cached = [entries.get(name, "") for name in ("CMAKE_Fortran_FLAGS", f"CMAKE_Fortran_FLAGS_{kind.upper()}")]
    flags = _rule_flags(folder) or " ".join(cached)
    return {"compiler": entries.get("CMAKE_Fortran_COMPILER", "gfortran"), "flags": speed_flags(flags), "build_type": kind}


def _rule_flags(folder):
    """Flags with which the transfer kernels were compiled (Ninja or Make)"""
    rules = folder / "build.ninja"
    if rules.exists():
        text = rules.read_text()
        for where in (r"src/transfer/\S*kernel", "src/transfer/", "src/"):
            found = re.search(rf"^build {where}\S*: Fortran_COMPILER_.*\n(?:  .*\n)*?  FLAGS = (.*)$", text, re.MULTILINE)
            if found:
                return found.group(1)
    made = folder / "src" / "transfer" / "CMakeFiles" / "gimp_transfer.dir" / "flags.make"
    if made.exists():
        found = re.search(r"^Fortran_FLAGS = (.*)$", made.read_text(), re.MULTILINE)
        if found:
            return found.group(1)
    return ""


def speed_flags(text):
    """The flags that decide about speed and rounding: no language standard, warnings, folders or preprocessor switches"""
    kept, skip = [], False
    for flag in shlex.split(text):
        if skip:
            skip = False
        elif flag in ("-J", "-I"):
            skip = True
        elif not re.match(r"-(std=|W|w$|J|I|D|g\d?$|cpp|fpp|ffree|ffixed|fpreprocessed|fopenmp)", flag):
            kept.append(flag)
    return " ".join(kept)


def needs_split(flags):
    """Whether vectors are 256 bits wide: then the reference is faster with its transfers in two passes"""
    if "-march=native" in flags:
        try:
            return "avx512f" not in Path("/proc/cpuinfo").read_text()
        except OSError:
            return False
    return not re.search(r"-m(arch=(x86-64-v4|skylake-avx512|icelake|sapphirerapids|znver[45])|avx512f)", flags)


def reference_flags(build):
    """Flags of the reference: those of the product, split where that is faster"""
    return build["flags"] + (" -DSPLIT" if needs_split(build["flags"]) else "")


def build_reference(variant, build, folder):
    """Build one variant of the reference with the product's compiler and flags, unless it is there; its path and flags"""
    flags = reference_flags(build)
    mark = hashlib.sha256(f"{build['compiler']} {flags}".encode()).hexdigest()[:8]  # one folder for each set of flags
    program = Path(folder) / mark / variant
    sources = [HERE / "reference" / name for name in ("limit2d.F90", "limit3d.F90", "build.sh")]
    if program.exists() and program.stat().st_mtime > max(source.stat().st_mtime for source in sources):
        return program, flags
    done = subprocess.run([str(HERE / "reference" / "build.sh"), variant], text=True, capture_output=True,
                          env=dict(os.environ, FC=build["compiler"], FLAGS=flags, BIN=str(program.parent)))
    if done.returncode != 0:
        raise gf.GimpError(f"the reference does not build: {' | '.join((done.stderr or done.stdout).splitlines()[-3:])}")
    return program, flags


def find_program(build_folder, name="gimp.x"):
    """Path of a program of a build folder, or None; GIMP_X names another gimp.x"""
    if name == "gimp.x" and os.environ.get("GIMP_X"):
        return gf.find_gimp()
    program = Path(build_folder).resolve() / "bin" / name
    return str(program) if os.access(program, os.X_OK) else None


# ------------------------------------------------------------------------------------------------- the machine


def pinning(threads, cpus=None):
    """Command that pins to processors, and the environment for it"""
    environment = {"OMP_NUM_THREADS": str(threads), "OMP_PROC_BIND": "true", "OMP_WAIT_POLICY": "active"}
    if not shutil.which("taskset"):
        gf.say("taskset is not there: runs are pinned by OMP_PROC_BIND only")
        return [], environment
    if not cpus:
        allowed = sorted(os.sched_getaffinity(0))
        if len(allowed) < threads:
            raise gf.GimpError(f"{threads} threads, but only {len(allowed)} processors")
        cpus = ",".join(map(str, allowed[:threads]))
    return ["taskset", "-c", cpus], environment


def machine(build):
    """Processor, caches, compiler and flags in words; nothing that names the place"""
    info = _read("/proc/cpuinfo")
    model = re.search(r"^model name\s*:\s*(.*)$", info, re.MULTILINE)
    caches = []
    for index in sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*")):
        level, kind, size = (_read(index / name).strip() for name in ("level", "type", "size"))
        if kind != "Instruction" and size:
            caches.append(f"L{level}{'d' if kind == 'Data' else ''} {size}")
    version = subprocess.run([build["compiler"], "--version"], text=True, capture_output=True).stdout.splitlines()
    vectors = next((name for word, name in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if re.search(rf"\b{word}\b", info)), "")
    return {"processor": " ".join(filter(None, [model.group(1) if model else "unknown processor", vectors])),
            "processors": len(os.sched_getaffinity(0)), "caches": ", ".join(caches),
            "virtual": "hypervisor" in info, "compiler_version": version[0] if version else "", "flags": build["flags"]}


def _read(path):
    try:
        return Path(path).read_text()
    except OSError:
        return ""


def available_memory():
    """Bytes that a run may take: what the kernel calls available, less where a control group allows less"""
    found = re.search(r"^MemAvailable:\s*(\d+) kB", _read("/proc/meminfo"), re.MULTILINE)
    free = 1024*int(found.group(1)) if found else os.sysconf("SC_AVPHYS_PAGES")*os.sysconf("SC_PAGE_SIZE")
    limit, used = _read("/sys/fs/cgroup/memory.max").strip(), _read("/sys/fs/cgroup/memory.current").strip()
    return min(free, int(limit) - int(used)) if limit.isdigit() and used.isdigit() else free


def own_peak():
    """Peak resident bytes of this process: that of a child below it is not the child's own"""
    return 1024*resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def roofline(program, arguments=(), threads=None):
    """Lines of gimp_roofline.x as dictionaries; none where the program is missing"""
    if not program:
        return []
    prefix, environment = pinning(threads) if threads else ([], {"OMP_PROC_BIND": "true"})
    more = ["--threads", str(threads)] if threads else []
    done = subprocess.run([*prefix, program, "--json", *more, *arguments], text=True, capture_output=True, env=dict(os.environ, **environment))
    if done.returncode != 0:
        raise gf.GimpError(f"{Path(program).name} ended with code {done.returncode}: {done.stderr.strip()[:200]}")
    return [json.loads(line) for line in done.stdout.splitlines()]


def limits(lines, threads):
    """Medians over all samples of a run for so many threads: memory [GB/s], multiply-adds in double and single [Gflop/s]"""

    def middle(what, key):
        values = [line[key] for line in lines if line["what"] == what and line["threads"] == threads]
        return statistics.median(values) if values else None

    return {"memory": middle("bandwidth_dram", "update_gbs"), 64: middle("fma", "dp_gflops"), 32: middle("fma", "sp_gflops")}

#!/usr/bin/env bash
# From a bare machine to a picture, or to a tested build, with one command: see `./bootstrap.sh help`.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd -P)
called_from=$PWD
build=$root/build
gimp=$build/bin/gimp.x
jobs=${JOBS:-$(nproc 2>/dev/null || getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2)}
modules_to_run="numpy h5py matplotlib"

say() { printf '%s\n' "$*"; }
warn() { printf 'bootstrap: %s\n' "$*" >&2; }
die() { warn "$*"; exit 1; }

usage() {
  cat <<'HELP'
usage: ./bootstrap.sh COMMAND

  run [INPUT]   build, run the scene INPUT (default: inputs/two_disks.nml) in a new folder under
                runs/, draw a PNG of it and say where both are
  test          build, run the unit tests and the tests of whole runs, end with one summary line
  build         install what is missing and build: the program is build/bin/gimp.x, with MPI
                also gimp_mpi.x, with coarrays also gimp_caf.x
  help          this text

On Debian and Ubuntu (as root or with sudo) missing packages are installed with apt-get; nothing is
fetched if nothing is missing. Elsewhere the packages are named, and the work goes on if the tools
are found. Environment: PYTHON (interpreter to use), JOBS (compile jobs), CMAKE_GENERATOR.
HELP
}

# --- what the machine has -------------------------------------------------------------------------

has() { command -v "$1" >/dev/null 2>&1; }

# True if the HDF5 library with its Fortran modules is there; asked of what each system offers
has_hdf5_fortran() {
  has h5fc && return 0
  if has dpkg-query; then
    dpkg-query -W -f='${Status}' libhdf5-dev 2>/dev/null | grep -q 'ok installed' && return 0
  fi
  has pkg-config && pkg-config --exists hdf5_fortran 2>/dev/null && return 0
  [[ -n ${HDF5_ROOT:-}${HDF5_DIR:-} ]] # cmake will say if it does not suit
}

has_lapack() { # any that cmake can link: Debian's, or another one under its names
  if has dpkg-query; then
    local package
    for package in liblapack-dev libopenblas-dev; do
      dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' && return 0
    done
  fi
  has pkg-config && { pkg-config --exists lapack 2>/dev/null || pkg-config --exists openblas 2>/dev/null; } && return 0
  [[ $(uname) == Darwin ]] # part of the system
}

# Either kind of processes that work together; the program that needs them is left out without them
has_mpi_fortran() { has mpirun && has mpifort; }
has_coarrays() {
  if has dpkg-query; then
    dpkg-query -W -f='${Status}' libcoarrays-openmpi-dev 2>/dev/null | grep -q 'ok installed' && return 0
  fi
  has caf
}

python_with() { # python_with INTERPRETER MODULE...: true if it can import them all
  local python=$1; shift
  has "$python" || return 1
  local IFS=,
  "$python" -c "import $*" >/dev/null 2>&1
}

# The first interpreter that can import the modules; the one on PATH may well be another one than the
# system's, without them.
find_python() {
  local candidate
  for candidate in "${PYTHON:-}" "$root/.venv/bin/python" /usr/bin/python3 python3; do
    if [[ -n $candidate ]] && python_with "$candidate" "$@"; then
      command -v "$candidate"
      return 0
    fi
  done
  return 1
}

# The system's own interpreter is the one that apt-get can give modules to
missing_packages() { # missing_packages MODULE...: Debian names of all that is not there
  has gfortran || echo gfortran libc6-dev
  has cmake || echo cmake
  has ninja || has make || echo ninja-build
  has fypp || [[ -x $root/.venv/bin/fypp ]] || echo fypp
  has_hdf5_fortran || echo libhdf5-dev
  has_lapack || echo liblapack-dev
  if [[ -e $root/.git ]]; then has git || echo git; fi
  if ! find_python "$@" >/dev/null; then
    [[ -x /usr/bin/python3 ]] || echo python3
    local module
    for module in "$@"; do
      python_with /usr/bin/python3 "$module" || echo "python3-$module"
    done
  fi
}

# What gimp_mpi.x and gimp_caf.x need; all else works without
missing_parallel_packages() {
  has_mpi_fortran || echo openmpi-bin libopenmpi-dev
  has_coarrays || echo openmpi-bin libcoarrays-openmpi-dev
}

# --- getting what is missing ----------------------------------------------------------------------

as_root() {
  if [[ $(id -u) -eq 0 ]]; then "$@"; else sudo "$@"; fi
}

may_install() {
  has apt-get || return 1
  [[ $(id -u) -eq 0 ]] && return 0
  has sudo || return 1
  sudo -n true 2>/dev/null || [[ -t 0 ]] # without a terminal nobody could answer a password question
}

install_packages() {
  say "installing with apt-get: $*"
  as_root env DEBIAN_FRONTEND=noninteractive apt-get update -qq \
    || warn "apt-get update failed; trying with the package lists at hand"
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

make_venv() { # make_venv MODULE...: the modules and fypp in .venv, for machines without apt-get
  local base
  for base in "${PYTHON:-}" python3 /usr/bin/python3; do
    if [[ -n $base ]] && has "$base"; then
      say "making .venv with: $*"
      "$base" -m venv "$root/.venv" \
        && "$root/.venv/bin/python" -m pip install --quiet --disable-pip-version-check "$@" \
        && return 0
    fi
  done
  return 1
}

prepare() { # prepare MODULE...: tools and a Python that imports the modules, or an end in plain words
  local missing
  missing=$(missing_packages "$@" | tr '\n' ' ')
  if [[ -n ${missing// /} ]]; then
    if may_install; then
      # shellcheck disable=SC2086 # one word per package
      install_packages $missing || warn "apt-get could not install all of: $missing"
    else
      warn "missing here; the Debian names are: $missing"
      warn "elsewhere: GNU Fortran 12 or newer, CMake 3.22 or newer, Ninja or Make, HDF5 with Fortran, LAPACK," \
        "fypp, and Python 3 with: $*"
    fi
  fi
  missing=$(missing_parallel_packages | tr '\n' ' ')
  if [[ -n ${missing// /} ]]; then
    # shellcheck disable=SC2086 # one word per package
    if ! may_install || ! install_packages $missing; then
      warn "runs on several ranks are left out; the Debian names of what they need are: $missing"
    fi
  fi

  local in_venv=()
  if ! has fypp && [[ ! -x $root/.venv/bin/fypp ]]; then in_venv+=(fypp); fi
  if ! find_python "$@" >/dev/null; then in_venv+=("$@"); fi
  if [[ ${#in_venv[@]} -gt 0 ]]; then
    make_venv "${in_venv[@]}" || warn "could not make .venv with: ${in_venv[*]}"
  fi
  if ! has fypp && [[ -x $root/.venv/bin/fypp ]]; then export PATH=$PATH:$root/.venv/bin; fi

  local lacking=()
  has gfortran || lacking+=("gfortran")
  has cmake || lacking+=("cmake")
  has ninja || has make || lacking+=("ninja or make")
  has fypp || lacking+=("fypp")
  has_hdf5_fortran || warn "HDF5 with Fortran was not seen; cmake will look for it (HDF5_ROOT names its folder)"
  PYTHON=$(find_python "$@") || lacking+=("a python3 with: $*")
  [[ ${#lacking[@]} -eq 0 ]] || die "cannot go on without: $(printf '%s; ' "${lacking[@]}")see the names above"
  export PYTHON
}

# meshio reads meshes of other programs for preprocessing/convert_mesh.py; all else works without
add_meshio() {
  python_with "$PYTHON" meshio && return 0
  case $PYTHON in
    /usr/bin/python3) ! may_install || install_packages python3-meshio || true ;;
    "$root/.venv/bin/python") "$PYTHON" -m pip install --quiet --disable-pip-version-check meshio || true ;;
  esac
  python_with "$PYTHON" meshio \
    || warn "meshes of other programs cannot be converted: $PYTHON has no meshio (Debian: python3-meshio; pip install meshio)"
}

# --- build ----------------------------------------------------------------------------------------

quietly() { # quietly LOG COMMAND...: only a failure shows what the command said
  local log=$1; shift
  if ! "$@" >"$log" 2>&1; then
    # errors first, since a long compiler log hides them; then the end, for failures of other kinds
    grep -n -i -E -A 4 'error|undefined reference' "$log" | head -n 80 >&2 || true
    say "--- end of $log" >&2
    tail -n 15 "$log" >&2
    return 1
  fi
}

build_release() {
  mkdir -p "$build"
  # A tree that was copied or moved still names its old place, which cmake refuses
  if [[ -f $build/CMakeCache.txt ]] \
    && ! grep -q -x -F "CMAKE_HOME_DIRECTORY:INTERNAL=$root" "$build/CMakeCache.txt"; then
    rm -rf "$build/CMakeCache.txt" "$build/CMakeFiles"
  fi
  if has ninja && [[ ! -f $build/CMakeCache.txt ]]; then export CMAKE_GENERATOR=${CMAKE_GENERATOR:-Ninja}; fi
  (cd "$root" && quietly "$build/configure.log" cmake --preset release) \
    || die "configuring failed; all of it is in $build/configure.log"
  say "building with $jobs jobs ..."
  quietly "$build/build.log" cmake --build "$build" --parallel "$jobs" \
    || die "the build failed; all of it is in $build/build.log"
  printf '%s\n' "$PYTHON" >"$build/python.path"
  [[ -x $gimp ]] || die "the build ended without $gimp"
  local program programs=$gimp
  for program in "$build/bin/gimp_mpi.x" "$build/bin/gimp_caf.x"; do
    [[ ! -x $program ]] || programs+=", $(basename "$program")"
  done
  say "built $programs"
}

# --- run ------------------------------------------------------------------------------------------

new_folder() { # new_folder NAME: an unused folder under runs/; no result is ever overwritten
  local folder=$root/runs/$1 number=1
  mkdir -p "$root/runs"
  while ! mkdir "$folder" 2>/dev/null; do
    number=$((number + 1))
    folder=$root/runs/$1.$number
    [[ $number -lt 10000 ]] || die "cannot make a folder in $root/runs"
  done
  say "$folder"
}

link_named_files() { # link_named_files INPUT: files of particles and meshes, relative to the scene or to the repository, are found in the new folder
  local name folder
  sed -n -E "s/.*\bfile[[:space:]]*=[[:space:]]*[\"']([^\"'/][^\"']*)[\"'].*/\1/Ip" "$1" | while read -r name; do
    for folder in "$(cd "$(dirname "$1")" && pwd -P)" "$root"; do
      if [[ -e $folder/$name ]]; then
        mkdir -p "$(dirname "$name")"
        ln -sf "$folder/$name" "$name"
        break
      fi
    done
  done
}

draw() { # draw FILE OPTION...: a picture beside the file
  local picture=${1%.vtkhdf}.png
  if "$PYTHON" "$root/postprocessing/render.py" "$@" --output "$picture" >render.log 2>&1; then
    say "picture: $PWD/$picture"
  else
    warn "no picture; render.py said:"
    tail -n 5 render.log >&2
    return 1
  fi
}

run_scene() { # run_scene INPUT RENDER_OPTION...
  local input=$1 folder status=0 file
  shift
  folder=$(new_folder "$(basename "${input%.nml}")")
  cd "$folder"
  link_named_files "$input"
  "$gimp" <"$input" || status=$?
  [[ $status -eq 0 ]] || warn "gimp.x ended with exit code $status (1: the run failed, 2: bad input)"
  for file in *.vtkhdf; do
    [[ -e $file ]] || continue
    say "results: $folder/$file"
    draw "$file" "$@" || [[ $status -ne 0 ]] || status=1
  done
  rmdir "$folder" 2>/dev/null || true # a scene that was refused leaves nothing
  return "$status"
}

# --- test -----------------------------------------------------------------------------------------

run_tests() {
  local unit=0 runs=0 unit_words runs_words
  say "unit tests ..."
  ctest --test-dir "$build" -LE long --output-on-failure --parallel "$jobs" >"$build/ctest.log" 2>&1 || unit=$?
  [[ $unit -eq 0 ]] || grep -v -E '^ *[0-9]+/[0-9]+ Test .* Passed|^ *Start ' "$build/ctest.log" >&2 || true
  unit_words=$(grep -E 'tests passed|tests failed|No tests' "$build/ctest.log" | tail -n 1 || true)
  if [[ $unit_words == *"No tests"* || -z $unit_words ]]; then unit=1; unit_words="no unit tests were found"; fi

  say "tests of whole runs ..."
  (cd "$root" && GIMP_X=${GIMP_X:-$gimp} "$PYTHON" -m pytest -q -p no:cacheprovider tests/runs) 2>&1 \
    | tee "$build/pytest.log" || runs=$?
  runs_words=$(grep -E '[0-9]+ (passed|failed|error)|no tests ran' "$build/pytest.log" | tail -n 1 | tr -d '=' || true)

  local verdict="all tests passed"
  [[ $unit -eq 0 && $runs -eq 0 ]] || verdict="TESTS FAILED"
  say "$verdict: unit: ${unit_words## }; runs: ${runs_words## }"
  [[ $unit -eq 0 && $runs -eq 0 ]]
}

# --- commands -------------------------------------------------------------------------------------

case ${1:-help} in
  run)
    input=${2:-$root/inputs/two_disks.nml}
    picture=(--field velocity --component magnitude) # of the last frame
    # the demonstration as a strip: apart, at contact, flattest, after it
    [[ $# -ge 2 ]] || picture=(--field von_mises --frames "5,17,20,36" --limits 0 300 --dpi 100)
    [[ $input == /* ]] || input=$called_from/$input
    [[ -f $input && -r $input ]] || die "no such scene: $input"
    # shellcheck disable=SC2086 # one word per module
    prepare $modules_to_run
    build_release
    run_scene "$input" "${picture[@]}"
    ;;
  test)
    # shellcheck disable=SC2086 # one word per module
    prepare $modules_to_run pytest
    add_meshio
    build_release
    run_tests
    ;;
  build)
    # shellcheck disable=SC2086 # one word per module
    prepare $modules_to_run
    add_meshio
    build_release
    ;;
  help | -h | --help) usage ;;
  *)
    usage >&2
    exit 2
    ;;
esac

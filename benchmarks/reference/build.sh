#!/bin/sh
# Build the speed-of-light programs: all of them, or only those that are named, e.g. `./build.sh ugimp3d_64 linear3d_64`.
# From outside: FC compiler, FLAGS its flags (for AVX2 add -DSPLIT), BIN folder of the executables (default: bin beside this file).
# Kernels that are called once must not be inlined: gfortran would unroll their lane loops before it vectorises them.
FC=${FC:-gfortran}
FLAGS=${FLAGS:--O3 -march=native -fno-math-errno -fno-trapping-math}
here=$(cd "$(dirname "$0")" && pwd) || exit 1
BIN=${BIN:-$here/bin}
mkdir -p "$BIN" || exit 1
wanted=" $* "
built=0

# build NAME SOURCE [option...]: does nothing if names were given and NAME is not one of them
build() {
  out=$1; src=$2; shift 2
  case "$wanted" in "  " | *" $out "*) ;; *) return 0 ;; esac
  mkdir -p "$BIN/mod_$out"   # one module folder each: variants share a module name
  $FC $FLAGS -fno-inline-functions-called-once -fopenmp -ffree-line-length-none -J "$BIN/mod_$out" "$@" "$here/$src" -o "$BIN/$out" || exit 1
  built=$((built + 1))
}

for dim in 3d 2d; do
  for bits in 64 32; do
    real=; [ $bits = 32 ] && real=-DSP
    build flip${dim}_$bits limit$dim.F90 $real
    build apic${dim}_$bits limit$dim.F90 $real -DAPIC
    build linear${dim}_$bits limit$dim.F90 $real -DSHAPE=1
    build ugimp${dim}_$bits limit$dim.F90 $real -DSHAPE=3
    build cpgimp${dim}_$bits limit$dim.F90 $real -DSHAPE=4
  done
done
build cpdi3d_64 limit3d.F90 -DSHAPE=5
build cpdi3d_32 limit3d.F90 -DSHAPE=5 -DSP
if [ $built = 0 ]; then
  echo "build.sh: no variant is called$wanted; see README.md" >&2
  exit 1
fi

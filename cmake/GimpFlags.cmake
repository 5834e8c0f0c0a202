# Compiler flags by build type. The release flags were chosen by measurement (docs/performance.md): no fast-math, so that
# results do not change silently; the two -fno flags let loops with log and sqrt vectorise and change no value.
set(speed "-O3 -fno-math-errno -fno-trapping-math")
set(CMAKE_Fortran_FLAGS "${CMAKE_Fortran_FLAGS} -std=f2018 -ffree-line-length-none -fopenmp -Wall -Wextra -Wimplicit-interface -Wno-compare-reals -Wno-unused-dummy-argument -Wno-maybe-uninitialized")
set(CMAKE_Fortran_FLAGS_RELEASE "${speed} -march=native")
set(CMAKE_Fortran_FLAGS_PORTABLE "${speed} -march=x86-64-v3")
set(checks "-fcheck=all,no-array-temps -ffpe-trap=invalid,zero,overflow -finit-real=snan -fbacktrace")
set(CMAKE_Fortran_FLAGS_DEBUG "-Og -g ${checks}")
set(CMAKE_Fortran_FLAGS_ASAN "-O1 -g -fcheck=all,no-array-temps -fsanitize=address,undefined -fno-omit-frame-pointer -fbacktrace")
set(CMAKE_EXE_LINKER_FLAGS_ASAN "-fsanitize=address,undefined")
set(CMAKE_Fortran_FLAGS_COVERAGE "-O0 -g --coverage")
set(CMAKE_EXE_LINKER_FLAGS_COVERAGE "--coverage")

# Transfers in two loops of four fields where vectors hold four reals: x86-64-v3 has 16 registers of 256 bits (measured: half as
# fast again as one loop of eight there, and a quarter slower with AVX-512)
set(wide_vectors FALSE)
if(CMAKE_BUILD_TYPE STREQUAL "Release" AND EXISTS /proc/cpuinfo) # the processor that -march=native sees
  file(READ /proc/cpuinfo processor LIMIT 8000)
  if(processor MATCHES "avx512f")
    set(wide_vectors TRUE)
  endif()
endif()
if(NOT wide_vectors)
  set(GIMP_FYPP_OPTIONS_double -DSPLIT) # 256 bits hold the eight fields in single precision
endif()

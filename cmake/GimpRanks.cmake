# Ways in which ranks work together, and how programs on several of them are started
find_package(MPI COMPONENTS Fortran)
option(GIMP_MPI "Build gimp_mpi.x, which runs on several ranks, beside gimp.x" ${MPI_Fortran_HAVE_F08_MODULE})
if(GIMP_MPI AND NOT MPI_Fortran_HAVE_F08_MODULE)
  message(FATAL_ERROR "GIMP_MPI needs an MPI library with the module mpi_f08 (Debian: libopenmpi-dev)")
endif()

# OpenCoarrays is built for one MPI library, which its name tells in Debian
find_library(GIMP_COARRAY_LIBRARY NAMES caf_openmpi caf_mpi DOC "Library of coarrays: OpenCoarrays (Debian: libcoarrays-openmpi-dev)")
set(has_coarrays FALSE)
if(GIMP_COARRAY_LIBRARY AND MPIEXEC_EXECUTABLE)
  set(has_coarrays TRUE)
endif()
option(GIMP_COARRAY "Build gimp_caf.x, which runs on several images of coarrays, beside gimp.x" ${has_coarrays})
if(GIMP_COARRAY AND NOT has_coarrays)
  message(FATAL_ERROR "GIMP_COARRAY needs OpenCoarrays and mpiexec (Debian: libcoarrays-openmpi-dev, openmpi-bin)")
endif()

# How programs that run on several ranks are started: `-n N program`. The environment is for Open MPI (4, then 5): more ranks than
# cores, root in containers, ranks that wait leave their core to others; other libraries do not read it
set(GIMP_MPIRUN ${MPIEXEC_EXECUTABLE} ${MPIEXEC_PREFLAGS} ${MPIEXEC_NUMPROC_FLAG})
set(GIMP_RANK_ENVIRONMENT OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
  OMPI_MCA_rmaps_base_oversubscribe=1 OMPI_MCA_mpi_yield_when_idle=1 OMPI_MCA_hwloc_base_binding_policy=none
  PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe PRTE_MCA_hwloc_default_binding_policy=none)
if(CMAKE_BUILD_TYPE STREQUAL "Asan")
  list(APPEND GIMP_RANK_ENVIRONMENT ASAN_OPTIONS=detect_leaks=0) # MPI libraries end with some; ours show in serial tests
endif()

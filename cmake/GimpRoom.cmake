# gimp_expand(RESULT TEMPLATE FOLDER PRECISION): the Fortran file that fypp makes of a template for one working precision
function(gimp_expand result template folder precision)
  get_filename_component(base "${template}" NAME_WLE)
  set(expanded "${folder}/${precision}/${base}.f90")
  file(MAKE_DIRECTORY "${folder}/${precision}")
  file(GLOB parts CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/*.inc") # what templates include
  add_custom_command(OUTPUT "${expanded}"
    COMMAND "${FYPP}" -n "-DPRECISION='${precision}'" ${GIMP_FYPP_OPTIONS_${precision}}
            "${CMAKE_CURRENT_SOURCE_DIR}/${template}" "${expanded}"
    DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/${template}" ${parts} VERBATIM COMMENT "fypp ${template} (${precision})")
  set(${result} "${expanded}" PARENT_SCOPE)
endfunction()

# gimp_add_room(NAME [SHARED_BY_PRECISIONS] SOURCES file... [USES room...] [LIBRARIES target...])
# One room is one static library with a module directory of its own: a `use` of a room that is not listed does not compile.
# A room is built twice from the same sources: gimp_NAME in double precision and, unless GIMP_SINGLE is off, gimp_NAME_sp in
# single. One that never mentions the working precision is SHARED_BY_PRECISIONS and built once.
function(gimp_add_room name)
  cmake_parse_arguments(ROOM "SHARED_BY_PRECISIONS" "" "SOURCES;USES;LIBRARIES" ${ARGN})
  gimp_add_room_library(${name} "" double)
  if(GIMP_SINGLE AND NOT ROOM_SHARED_BY_PRECISIONS)
    gimp_add_room_library(${name} _sp single)
  endif()
endfunction()

# The library of a room in one precision; reads the arguments of gimp_add_room
function(gimp_add_room_library name suffix precision)
  set(sources "")
  foreach(source IN LISTS ROOM_SOURCES)
    get_filename_component(extension "${source}" LAST_EXT)
    if(extension STREQUAL ".fypp")
      gimp_expand(expanded "${source}" "${CMAKE_CURRENT_BINARY_DIR}" ${precision})
      list(APPEND sources "${expanded}")
    else()
      list(APPEND sources "${source}")
    endif()
  endforeach()
  set(library gimp_${name}${suffix})
  add_library(${library} STATIC ${sources})
  set(modules "${CMAKE_BINARY_DIR}/modules/${name}${suffix}")
  file(MAKE_DIRECTORY "${modules}")
  set_target_properties(${library} PROPERTIES Fortran_MODULE_DIRECTORY "${modules}")
  target_include_directories(${library} PUBLIC "${modules}")
  foreach(room IN LISTS ROOM_USES)
    gimp_library(used ${room} "${suffix}")
    target_link_libraries(${library} PUBLIC ${used})
  endforeach()
  target_link_libraries(${library} PUBLIC ${ROOM_LIBRARIES} OpenMP::OpenMP_Fortran)
endfunction()

# The library of a room that one of this precision uses: its own, or the one that both precisions share
function(gimp_library result room suffix)
  set(library gimp_${room})
  if(TARGET gimp_${room}${suffix})
    set(library gimp_${room}${suffix})
  endif()
  set(${result} ${library} PARENT_SCOPE)
endfunction()

# gimp_add_unit_test(ROOM test_name [SINGLE] [USES room...]): tests/unit/ROOM/test_name.f90 (or .fypp) becomes the ctest
# ROOM.test_name; with SINGLE the suite also runs in single precision, as ROOM.test_name.single
function(gimp_add_unit_test room name)
  cmake_parse_arguments(TEST "SINGLE" "" "USES" ${ARGN})
  foreach(needed IN LISTS room TEST_USES)
    if(NOT TARGET gimp_${needed})
      return()
    endif()
  endforeach()
  gimp_add_suite(${room} ${name} ${room}.${name} "" double)
  if(TEST_SINGLE AND GIMP_SINGLE)
    gimp_add_suite(${room} ${name} ${room}.${name}.single _sp single)
  endif()
endfunction()

# A suite in one precision; reads the arguments of gimp_add_unit_test
function(gimp_add_suite room name test suffix precision)
  set(suite ${name}${suffix})
  set(source unit/${room}/${name}.f90)
  if(EXISTS "${CMAKE_CURRENT_SOURCE_DIR}/unit/${room}/${name}.fypp")
    gimp_expand(source unit/${room}/${name}.fypp "${CMAKE_CURRENT_BINARY_DIR}" ${precision})
  endif()
  add_executable(${suite} ${source})
  set_target_properties(${suite} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/tests"
    Fortran_MODULE_DIRECTORY "${CMAKE_BINARY_DIR}/modules/tests/${suite}")
  target_link_libraries(${suite} PRIVATE gimp_check)
  if(TARGET gimp_ranks_serial)
    target_link_libraries(${suite} PRIVATE gimp_ranks_serial)
  endif()
  foreach(needed IN LISTS room TEST_USES)
    gimp_library(used ${needed} "${suffix}")
    target_link_libraries(${suite} PRIVATE ${used})
  endforeach()
  add_test(NAME ${test} COMMAND ${suite})
  set_tests_properties(${test} PROPERTIES LABELS unit)
endfunction()

# How programs that run on several ranks are started: `-n N program`. The environment is for Open MPI (4, then 5): more ranks than
# cores, root in containers, ranks that wait leave their core to others; other libraries do not read it
set(GIMP_MPIRUN ${MPIEXEC_EXECUTABLE} ${MPIEXEC_PREFLAGS} ${MPIEXEC_NUMPROC_FLAG})
set(GIMP_RANK_ENVIRONMENT OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
  OMPI_MCA_rmaps_base_oversubscribe=1 OMPI_MCA_mpi_yield_when_idle=1 OMPI_MCA_hwloc_base_binding_policy=none
  PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe PRTE_MCA_hwloc_default_binding_policy=none)

# gimp_add_rank_test(ROOM test_name RANKS n... [USES room...]): a suite that ends with end_ranks. It runs as ROOM.test_name.serial and, with
# each way of working together that is built, as ROOM.test_name.mpi.n and ROOM.test_name.coarray.n
function(gimp_add_rank_test room name)
  cmake_parse_arguments(TEST "" "" "RANKS;USES" ${ARGN})
  foreach(needed IN LISTS room TEST_USES)
    if(NOT TARGET gimp_${needed})
      return()
    endif()
  endforeach()
  foreach(backend serial mpi coarray)
    if(NOT TARGET gimp_ranks_${backend})
      continue()
    endif()
    set(suite ${name}_${backend})
    add_executable(${suite} unit/${room}/${name}.f90)
    set_target_properties(${suite} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/tests"
      Fortran_MODULE_DIRECTORY "${CMAKE_BINARY_DIR}/modules/tests/${suite}")
    target_link_libraries(${suite} PRIVATE gimp_check gimp_ranks_${backend} gimp_${room})
    foreach(needed IN LISTS TEST_USES)
      target_link_libraries(${suite} PRIVATE gimp_${needed})
    endforeach()
    if(backend STREQUAL serial)
      add_test(NAME ${room}.${name}.serial COMMAND ${suite})
      set_tests_properties(${room}.${name}.serial PROPERTIES LABELS unit TIMEOUT 60)
      continue()
    endif()
    foreach(ranks IN LISTS TEST_RANKS)
      set(test ${room}.${name}.${backend}.${ranks})
      file(MAKE_DIRECTORY "${CMAKE_BINARY_DIR}/tests/${test}") # suites write files
      add_test(NAME ${test} WORKING_DIRECTORY "${CMAKE_BINARY_DIR}/tests/${test}"
        COMMAND ${GIMP_MPIRUN} ${ranks} $<TARGET_FILE:${suite}>)
      set_tests_properties(${test} PROPERTIES LABELS unit TIMEOUT 60 PROCESSORS ${ranks} ENVIRONMENT "${GIMP_RANK_ENVIRONMENT}")
    endforeach()
  endforeach()
endfunction()

# Tests of whole runs with --long, by the first Python that has their modules, in the order in which bootstrap.sh looks.
# cmake -DPROGRAM=gimp.x -DTESTS=runs/test_matrix.py -P long_runs.cmake; the environment variable PYTHON names another one
foreach(candidate "$ENV{PYTHON}" "${CMAKE_CURRENT_LIST_DIR}/../.venv/bin/python" /usr/bin/python3 python3)
  if(candidate STREQUAL "")
    continue()
  endif()
  execute_process(COMMAND "${candidate}" -c "import numpy, h5py, pytest" RESULT_VARIABLE missing OUTPUT_QUIET ERROR_QUIET)
  if(missing EQUAL 0)
    execute_process(COMMAND ${CMAKE_COMMAND} -E env "GIMP_X=${PROGRAM}" "${candidate}" -m pytest -q -p no:cacheprovider --long ${TESTS}
      RESULT_VARIABLE failed)
    if(NOT failed EQUAL 0)
      message(FATAL_ERROR "${TESTS} failed")
    endif()
    return()
  endif()
endforeach()
message(FATAL_ERROR "no python3 with numpy, h5py and pytest was found; ./bootstrap.sh build installs them, PYTHON names one")

gimp_add_unit_test(output test_vtkhdf USES files)
gimp_add_unit_test(output test_history USES files)

# Kill a writer, then read with h5py: needs a Python that has it
if(TARGET gimp_output)
  add_executable(crash_writer unit/output/crash_writer.f90)
  set_target_properties(crash_writer PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/tests")
  target_link_libraries(crash_writer PRIVATE gimp_output gimp_ranks_serial)
  # the runtime's backtrace catches the signal of a file size limit, which stands for a full disk here
  target_compile_options(crash_writer PRIVATE -fno-backtrace)
  add_test(NAME output.kill COMMAND ${CMAKE_COMMAND} -DWRITER=$<TARGET_FILE:crash_writer> -DKILLS=10
    -DSCRIPT=${CMAKE_CURRENT_LIST_DIR}/check_crash.py -P ${CMAKE_CURRENT_LIST_DIR}/run_with_h5py.cmake)
  set_tests_properties(output.kill PROPERTIES LABELS unit SKIP_REGULAR_EXPRESSION "no python3 with h5py")
endif()
gimp_add_rank_test(output test_checkpoint RANKS 1 3 USES files)

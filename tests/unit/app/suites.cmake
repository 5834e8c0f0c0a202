# alone it writes what it finds on ranks, all in one folder
gimp_add_rank_test(app test_populate RANKS 2 5)
foreach(test serial mpi.2 mpi.5 coarray.2 coarray.5)
  if(TEST app.test_populate.${test})
    set_tests_properties(app.test_populate.${test} PROPERTIES WORKING_DIRECTORY "${CMAKE_BINARY_DIR}/tests"
      FIXTURES_REQUIRED populated_alone)
  endif()
endforeach()
if(TEST app.test_populate.serial)
  set_tests_properties(app.test_populate.serial PROPERTIES FIXTURES_SETUP populated_alone FIXTURES_REQUIRED "")
endif()

# What `gimp.x --version` and the output file say about the build. The commit is asked at every build, so that a rebuilt
# executable never names an older one.
set(GIMP_COMMIT_FILE "${CMAKE_BINARY_DIR}/gimp_commit.inc")
add_custom_target(gimp_commit ALL
  COMMAND ${CMAKE_COMMAND} -DSOURCE=${CMAKE_CURRENT_SOURCE_DIR} -DOUTPUT=${GIMP_COMMIT_FILE}
          -P ${CMAKE_CURRENT_SOURCE_DIR}/cmake/write_commit.cmake
  BYPRODUCTS ${GIMP_COMMIT_FILE})

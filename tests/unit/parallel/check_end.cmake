# COMMAND must end with the exit code CODE and have said WORDS: ranks hand on what the shell, and a batch queue, go by
execute_process(COMMAND ${COMMAND} RESULT_VARIABLE result OUTPUT_VARIABLE output ERROR_VARIABLE error)
if(NOT result STREQUAL "${CODE}")
  message(FATAL_ERROR "exit code ${result}, expected ${CODE}\n${output}${error}")
endif()
if(NOT output MATCHES "${WORDS}")
  message(FATAL_ERROR "'${WORDS}' is not in:\n${output}")
endif()

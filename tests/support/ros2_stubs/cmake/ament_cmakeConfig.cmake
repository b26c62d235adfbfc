# The functions of ament that a package calls; what they are given is written to a file.
file(WRITE "${CMAKE_BINARY_DIR}/ament_calls.txt" "")
function(ament_package)
  file(APPEND "${CMAKE_BINARY_DIR}/ament_calls.txt" "ament_package\n")
endfunction()
function(ament_add_gtest name)
  add_executable(${name} ${ARGN})
endfunction()

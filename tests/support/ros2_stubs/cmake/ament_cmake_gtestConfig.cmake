# ament_add_gtest is in ament_cmakeConfig.cmake.

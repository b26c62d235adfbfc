add_library(rclcpp_lifecycle::rclcpp_lifecycle INTERFACE IMPORTED)
set_target_properties(rclcpp_lifecycle::rclcpp_lifecycle PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${STUBS}")

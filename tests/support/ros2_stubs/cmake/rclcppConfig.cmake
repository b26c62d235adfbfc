add_library(rclcpp::rclcpp INTERFACE IMPORTED)
set_target_properties(rclcpp::rclcpp PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${STUBS}")

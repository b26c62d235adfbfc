
find_package(controller_interface REQUIRED)
find_package(hardware_interface REQUIRED)
#if MODEL_FORCE
find_package(geometry_msgs REQUIRED)
#endif /* MODEL_FORCE */
find_package(rclcpp_lifecycle REQUIRED)
find_package(std_msgs REQUIRED)
add_library(flexgen_model_stream_controller SHARED src/stream_controller.cpp)
target_compile_features(flexgen_model_stream_controller PUBLIC cxx_std_17)
target_include_directories(flexgen_model_stream_controller PUBLIC
  $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>
  $<INSTALL_INTERFACE:include/flexgen_model>)
target_link_libraries(flexgen_model_stream_controller
  PRIVATE flexgen_model_library
  PUBLIC controller_interface::controller_interface hardware_interface::hardware_interface
  pluginlib::pluginlib rclcpp::rclcpp rclcpp_lifecycle::rclcpp_lifecycle ${std_msgs_TARGETS})
#if MODEL_FORCE
target_link_libraries(flexgen_model_stream_controller PUBLIC ${geometry_msgs_TARGETS})
#endif /* MODEL_FORCE */
pluginlib_export_plugin_description_file(controller_interface controller_plugin.xml)
install(TARGETS flexgen_model_stream_controller LIBRARY DESTINATION lib)
install(DIRECTORY config launch DESTINATION share/flexgen_model)

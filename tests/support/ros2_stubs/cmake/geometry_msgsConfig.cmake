add_library(geometry_msgs::geometry_msgs INTERFACE IMPORTED)
set_target_properties(geometry_msgs::geometry_msgs PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${STUBS}")
set(geometry_msgs_TARGETS geometry_msgs::geometry_msgs)

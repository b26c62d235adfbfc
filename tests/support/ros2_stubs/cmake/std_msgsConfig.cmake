add_library(std_msgs::std_msgs INTERFACE IMPORTED)
set_target_properties(std_msgs::std_msgs PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${STUBS}")
set(std_msgs_TARGETS std_msgs::std_msgs)

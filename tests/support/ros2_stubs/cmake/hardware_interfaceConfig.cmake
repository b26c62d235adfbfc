add_library(hardware_interface::hardware_interface INTERFACE IMPORTED)
set_target_properties(hardware_interface::hardware_interface PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${STUBS}")

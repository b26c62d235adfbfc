add_library(controller_interface::controller_interface INTERFACE IMPORTED)
set_target_properties(controller_interface::controller_interface PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${STUBS}")

"""Files by which other projects find the library: its CMakeLists.txt and its pkg-config file, as
text.

The text depends on the library's name, its sources and whether its batches use OpenMP; no path is
in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from string import Template

from flexgen.codegen.build.compiler import NATIVE, OPENMP, REPRODUCIBLE, SOLVER_FLAGS, SOLVERS
from flexgen.codegen.emission.interface import ABI_VERSION


def packaging(
    name: str, sources: Sequence[str], headers: Sequence[str], *, openmp: bool = False
) -> dict[str, str]:
    """Text of ``CMakeLists.txt`` and ``<name>.pc``.

    Parameters
    ----------
    name : str
        Of the library.
    sources : sequence of str
        Names of its C files, without the example.
    headers : sequence of str
        Names of its public headers.
    openmp : bool
        Whether their library is built with OpenMP, as its users then have to link it.

    Returns
    -------
    dict of str to str
        By file name.
    """

    def options(flags: Sequence[str], levels: bool) -> str:
        return " ".join(
            flag for flag in flags if flag[:2] not in ("-s", "-O") or (levels and flag[:2] == "-O")
        )

    solvers = [
        file for file in sources if file.endswith(tuple(f"/{name}_{solver}" for solver in SOLVERS))
    ]
    values = {
        "name": name,
        "NAME": name.upper(),
        "version": f"{ABI_VERSION}.0",
        "headers": " ".join(headers),
        "sources": "\n".join(f"  {file}" for file in sources),
        "reproducible": options(REPRODUCIBLE, False),
        "level": next(flag for flag in REPRODUCIBLE if flag.startswith("-O")),
        "native": options(NATIVE, True),
    }
    unrolled = Template(_UNROLLED).substitute(
        flags=";".join(SOLVER_FLAGS), files=" ".join(solvers)
    )
    values["unrolled"] = unrolled if solvers else ""
    pc = Template(_PC).substitute(values, openmp=f" {OPENMP}" if openmp else "")
    return {"CMakeLists.txt": Template(_CMAKE).substitute(values), f"{name}.pc": pc}


# "$$" is a dollar sign of the text.
_PC = """\
# $name, used in this folder: PKG_CONFIG_PATH=<this folder> pkg-config --cflags --libs $name
prefix=$${pcfiledir}

Name: $name
Description: Equations of motion of the robot $name, written by flexgen
Version: $version
Cflags: -I$${prefix}
Libs: -L$${prefix} -l$name -lm$openmp
"""

_UNROLLED = """\

# Unrolled loops make the solvers a tenth faster, and their code twice as long.
if(NOT MSVC AND NOT CMAKE_GENERATOR STREQUAL "Xcode") # Xcode has no flags for one source and one \
configuration
  set(unrolled "$$<$$<NOT:$$<OR:$$<CONFIG:Debug>,$$<CONFIG:MinSizeRel>>>:$flags>")
  set_source_files_properties($files PROPERTIES COMPILE_OPTIONS "$${unrolled}")
endif()
"""

_CMAKE = """\
# $name, written by flexgen; the manual is in $name.h.
#
#   cmake -S . -B build && cmake --build build && cmake --install build --prefix <where>
#
# Elsewhere: find_package($name CONFIG REQUIRED), or add_subdirectory of this folder, and then
# target_link_libraries(<target> PRIVATE flexgen::$name); or pkg-config --cflags --libs $name.
cmake_minimum_required(VERSION 3.14)
project(flexgen_$name VERSION $version LANGUAGES C)

option(BUILD_SHARED_LIBS "Build a shared library" OFF)
option(${NAME}_NATIVE "Compile for this processor: faster, results differ by rounding" OFF)
option(${NAME}_OPENMP "Batches use all cores (OpenMP)" OFF)

include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

add_library(flexgen_$name
$sources
)
add_library(flexgen::$name ALIAS flexgen_$name)
set_target_properties(flexgen_$name PROPERTIES
  EXPORT_NAME $name
  OUTPUT_NAME $name
  VERSION $${PROJECT_VERSION}
  SOVERSION $${PROJECT_VERSION_MAJOR}
  C_STANDARD 99
  C_STANDARD_REQUIRED ON
  C_EXTENSIONS OFF
  C_VISIBILITY_PRESET hidden
  POSITION_INDEPENDENT_CODE ON
)
target_include_directories(flexgen_$name PUBLIC
  "$$<BUILD_INTERFACE:$${CMAKE_CURRENT_SOURCE_DIR}>"
  "$$<INSTALL_INTERFACE:$${CMAKE_INSTALL_INCLUDEDIR}>"
)
if(BUILD_SHARED_LIBS)
  target_compile_definitions(flexgen_$name PRIVATE ${NAME}_SHARED)
endif()

# The same bits with every compiler, unless this processor's own are asked for; a debug build \
keeps its -O0 or -Og.
if(MSVC)
  target_compile_options(flexgen_$name PRIVATE /fp:precise)
elseif(${NAME}_NATIVE)
  target_compile_options(flexgen_$name PRIVATE $native)
else()
  target_compile_options(flexgen_$name PRIVATE $$<$$<NOT:$$<CONFIG:Debug>>:$level> $reproducible)
endif()
${unrolled}
set(math_pc "")
if(UNIX)
  target_link_libraries(flexgen_$name PRIVATE m)
  set(math_pc " -lm")
endif()
set(config "include(\\"\\$${CMAKE_CURRENT_LIST_DIR}/$name-targets.cmake\\")\\n")
if(${NAME}_OPENMP)
  find_package(OpenMP REQUIRED COMPONENTS C)
  target_link_libraries(flexgen_$name PRIVATE OpenMP::OpenMP_C)
  set(config "include(CMakeFindDependencyMacro)\\nfind_dependency(OpenMP COMPONENTS \
C)\\n$${config}")
  set(math_pc "$${math_pc} $${OpenMP_C_FLAGS}")
endif()

# --- installation ---
set(config_dir "$${CMAKE_INSTALL_LIBDIR}/cmake/$name")
file(WRITE "$${CMAKE_CURRENT_BINARY_DIR}/$name-config.cmake" "$${config}")
write_basic_package_version_file("$${CMAKE_CURRENT_BINARY_DIR}/$name-config-version.cmake"
  COMPATIBILITY SameMajorVersion
)
file(RELATIVE_PATH up "$${CMAKE_INSTALL_FULL_LIBDIR}/pkgconfig" "$${CMAKE_INSTALL_PREFIX}")
string(REGEX REPLACE "/$$" "" up "$${up}")
file(WRITE "$${CMAKE_CURRENT_BINARY_DIR}/$name.pc" "\\
prefix=\\$${pcfiledir}/$${up}

Name: $name
Description: Equations of motion of the robot $name, written by flexgen
Version: $version
Cflags: -I\\$${prefix}/$${CMAKE_INSTALL_INCLUDEDIR}
Libs: -L\\$${prefix}/$${CMAKE_INSTALL_LIBDIR} -l$name$${math_pc}
")
install(TARGETS flexgen_$name EXPORT $name-targets
  ARCHIVE DESTINATION "$${CMAKE_INSTALL_LIBDIR}"
  LIBRARY DESTINATION "$${CMAKE_INSTALL_LIBDIR}"
  RUNTIME DESTINATION "$${CMAKE_INSTALL_BINDIR}"
)
install(FILES $headers DESTINATION "$${CMAKE_INSTALL_INCLUDEDIR}")
install(EXPORT $name-targets NAMESPACE flexgen:: DESTINATION "$${config_dir}")
install(FILES
  "$${CMAKE_CURRENT_BINARY_DIR}/$name-config.cmake"
  "$${CMAKE_CURRENT_BINARY_DIR}/$name-config-version.cmake"
  DESTINATION "$${config_dir}"
)
install(FILES "$${CMAKE_CURRENT_BINARY_DIR}/$name.pc" DESTINATION \
"$${CMAKE_INSTALL_LIBDIR}/pkgconfig")
"""

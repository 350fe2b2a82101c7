include(${CMAKE_CURRENT_LIST_DIR}/FionaProtos.cmake)

# fiona_add_plugin(NAME SOURCES a.cpp ... [PROTOS publisher/name/params.proto ...] [LIBRARIES target ...]
#                  [MANIFEST manifest.textproto] [README README.md] [SHARE file ...])
#
# Builds the plugin library NAME, describes it, and packs NAME.fpk where `fiona-pack` is known. PROTOS are relative to
# the folder `proto` beside the CMakeLists.txt, under a path that begins with the publisher's id. SHARE are files that
# the component finds with `resource()`.
#
# Targets: NAME (the library), NAME-package (the .fpk; part of `all`). Property FIONA_PACKAGE of NAME: the .fpk's path.
function(fiona_add_plugin name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "MANIFEST;README" "SOURCES;PROTOS;LIBRARIES;SHARE")
  add_library(${name} MODULE ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE fiona::fiona ${arg_LIBRARIES})
  # One symbol leaves the plugin: its entry.
  set_target_properties(${name} PROPERTIES PREFIX "lib" CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON
                        LIBRARY_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR})
  target_link_options(${name} PRIVATE -Wl,--exclude-libs,ALL)
  # Of clang's sanitizers the run-time library is part of the program: a plugin finds it there, not when it is linked.
  if(NOT (CMAKE_CXX_COMPILER_ID STREQUAL "Clang" AND CMAKE_CXX_FLAGS MATCHES "-fsanitize"))
    target_link_options(${name} PRIVATE -Wl,--no-undefined)
  endif()
  if(arg_PROTOS)
    fiona_generate_protos(${name} ROOT ${CMAKE_CURRENT_SOURCE_DIR}/proto FILES ${arg_PROTOS})
  endif()

  set(interface ${CMAKE_CURRENT_BINARY_DIR}/${name}.interface.textproto)
  add_custom_command(
    OUTPUT ${interface}
    COMMAND fiona::fiona-describe $<TARGET_FILE:${name}> -o ${interface}
    DEPENDS ${name} fiona::fiona-describe
    VERBATIM)
  set(products ${interface})

  if(TARGET fiona::fiona-pack AND arg_MANIFEST)
    set(package ${CMAKE_CURRENT_BINARY_DIR}/${name}.fpk)
    set(extra)
    if(arg_README)
      list(APPEND extra --readme ${CMAKE_CURRENT_SOURCE_DIR}/${arg_README})
    endif()
    if(arg_SHARE)
      set(share ${CMAKE_CURRENT_BINARY_DIR}/${name}.share)
      list(APPEND extra --share ${share})
      set(copy_share COMMAND ${CMAKE_COMMAND} -E rm -rf ${share} COMMAND ${CMAKE_COMMAND} -E make_directory ${share}
                     COMMAND ${CMAKE_COMMAND} -E copy ${arg_SHARE} ${share})
    endif()
    add_custom_command(
      OUTPUT ${package}
      ${copy_share}
      COMMAND fiona::fiona-pack --manifest ${CMAKE_CURRENT_SOURCE_DIR}/${arg_MANIFEST} --interface ${interface}
              --library $<TARGET_FILE:${name}> ${extra} -o ${package}
      DEPENDS ${interface} ${name} fiona::fiona-pack ${arg_MANIFEST} ${arg_README} ${arg_SHARE}
      WORKING_DIRECTORY ${CMAKE_CURRENT_SOURCE_DIR}
      VERBATIM)
    list(APPEND products ${package})
    set_target_properties(${name} PROPERTIES FIONA_PACKAGE ${package})
  endif()
  add_custom_target(${name}-package ALL DEPENDS ${products})
endfunction()

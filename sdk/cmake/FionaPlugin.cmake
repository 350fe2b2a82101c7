include(${CMAKE_CURRENT_LIST_DIR}/FionaProtos.cmake)
include(${CMAKE_CURRENT_LIST_DIR}/FionaMessages.cmake)

# fiona_add_plugin(NAME SOURCES a.cpp ... [PROTOS publisher/name/params.proto ...] [LIBRARIES target ...]
#                  [MESSAGES publisher/name ...] [MANIFEST manifest.textproto] [README README.md] [SHARE file ...])
#
# Builds the plugin library NAME, describes it, and packs NAME.fpk where `fiona-pack` is known. PROTOS are relative to
# the folder `proto` beside the CMakeLists.txt, under a path that begins with the publisher's id. MESSAGES are packages of
# shared objects that it is compiled with. SHARE are files that the component finds with `resource()`.
#
# Targets: NAME (the library), NAME-package (the .fpk; part of `all`). Property FIONA_PACKAGE of NAME: the .fpk's path.
function(fiona_add_plugin name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "MANIFEST;README" "SOURCES;PROTOS;LIBRARIES;MESSAGES;SHARE")
  fiona_find_messages(${arg_MESSAGES})
  string(REPLACE / :: needed "${arg_MESSAGES}")
  _fiona_messages_of("${needed}" messages)
  add_library(${name} MODULE ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE fiona::fiona ${arg_LIBRARIES} ${needed})
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

  set(share)
  set(share_done)
  if(arg_SHARE)
    set(share ${CMAKE_CURRENT_BINARY_DIR}/${name}.share)
    set(share_done ${share}.done)
    add_custom_command(
      OUTPUT ${share_done}
      COMMAND ${CMAKE_COMMAND} -E rm -rf ${share}
      COMMAND ${CMAKE_COMMAND} -E make_directory ${share}
      COMMAND ${CMAKE_COMMAND} -E copy ${arg_SHARE} ${share}
      COMMAND ${CMAKE_COMMAND} -E touch ${share_done}
      DEPENDS ${arg_SHARE}
      WORKING_DIRECTORY ${CMAKE_CURRENT_SOURCE_DIR}
      VERBATIM)
  endif()
  fiona_describe_and_pack(${name} "${arg_MANIFEST}" "${arg_README}" "${share}" "${share_done}" "${messages}")
endfunction()

# What says what a library declares, and the package where there is `fiona-pack` and a manifest. SHARE is the folder of
# its data files, made by what SHARE_DONE are; MESSAGES the targets of the message packages that it needs.
function(fiona_describe_and_pack name manifest readme share share_done messages)
  set(interface ${CMAKE_CURRENT_BINARY_DIR}/${name}.interface.textproto)
  set(with)
  foreach(target IN LISTS messages)
    list(APPEND with --with $<TARGET_FILE:${target}>)
  endforeach()
  add_custom_command(
    OUTPUT ${interface}
    COMMAND fiona::fiona-describe $<TARGET_FILE:${name}> -o ${interface} ${with}
    DEPENDS ${name} fiona::fiona-describe
    VERBATIM)
  set(products ${interface} ${share_done})
  if(TARGET fiona::fiona-pack AND manifest)
    set(package ${CMAKE_CURRENT_BINARY_DIR}/${name}.fpk)
    set(extra)
    if(readme)
      list(APPEND extra --readme ${CMAKE_CURRENT_SOURCE_DIR}/${readme})
    endif()
    if(share)
      list(APPEND extra --share ${share})
    endif()
    add_custom_command(
      OUTPUT ${package}
      COMMAND fiona::fiona-pack --manifest ${CMAKE_CURRENT_SOURCE_DIR}/${manifest} --interface ${interface}
              --library $<TARGET_FILE:${name}> ${extra} -o ${package}
      DEPENDS ${interface} ${name} fiona::fiona-pack ${manifest} ${readme} ${share_done}
      WORKING_DIRECTORY ${CMAKE_CURRENT_SOURCE_DIR}
      VERBATIM)
    list(APPEND products ${package})
    set_target_properties(${name} PROPERTIES FIONA_PACKAGE ${package})
  endif()
  add_custom_target(${name}-package ALL DEPENDS ${products})
endfunction()

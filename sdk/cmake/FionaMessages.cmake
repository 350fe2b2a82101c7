# fiona_find_messages(publisher/name ...)
#
# Makes the target `publisher::name` of a message package that is installed (`fiona plugin messages` lists them): its
# library, and headers made from the proto files that it brings. Protos compiled from here on may import those.
function(fiona_find_messages)
  foreach(package IN LISTS ARGN)
    string(REPLACE / :: target ${package})
    if(NOT TARGET ${target})
      _fiona_import_messages(${package} ${target})
    endif()
  endforeach()
endfunction()

function(_fiona_import_messages package target)
  get_target_property(beside fiona::fiona-describe LOCATION)
  get_filename_component(beside ${beside} DIRECTORY)
  find_program(FIONA_COMMAND fiona HINTS ${beside} REQUIRED)
  execute_process(COMMAND ${FIONA_COMMAND} plugin messages ${package} --json
                  OUTPUT_VARIABLE found ERROR_VARIABLE said RESULT_VARIABLE code)
  if(NOT code EQUAL 0)
    message(FATAL_ERROR "there are no messages of ${package} to build with:\n${said}\n  next: fiona market install ${package}")
  endif()
  # One line a package: those that it needs first, itself last.
  string(REPLACE "\n" ";" lines "${found}")
  foreach(line IN LISTS lines)
    if(line STREQUAL "")
      continue()
    endif()
    string(JSON name GET "${line}" package)
    string(JSON library GET "${line}" library)
    string(JSON protos GET "${line}" protos)
    string(JSON list GET "${line}" list)
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${list})  # another version may be installed
    string(REPLACE / :: known ${name})
    if(NOT TARGET ${known})
      _fiona_imported_messages(${known} ${library} ${protos} "${needed}")
    endif()
    list(APPEND needed ${known})
  endforeach()
endfunction()

function(_fiona_imported_messages target library root needed)
  string(REPLACE :: - folder ${target})
  set(headers ${CMAKE_BINARY_DIR}/fiona-messages/${folder})
  _fiona_add_proto_root(${root})
  file(GLOB_RECURSE protos RELATIVE ${root} ${root}/*.proto)
  fiona_proto_commands(ROOT ${root} OUT ${headers} FILES ${protos} HEADERS made)
  # A library of its own makes them before those that include them are compiled.
  add_custom_target(${folder}-headers DEPENDS ${made})
  add_library(${target} SHARED IMPORTED GLOBAL)
  set_target_properties(${target} PROPERTIES IMPORTED_LOCATION ${library} FIONA_MESSAGES "${needed};${target}")
  target_include_directories(${target} SYSTEM INTERFACE ${headers})
  target_link_libraries(${target} INTERFACE fiona::fiona ${needed})
  _fiona_keep_linked(${target})
  add_dependencies(${target} ${folder}-headers)
endfunction()

# fiona_add_messages(publisher/name PROTOS publisher/name/objects.proto ... [MESSAGES publisher/name ...]
#                    [MANIFEST manifest.textproto] [README README.md])
#
# Builds the shared library of a package of kind MESSAGES: objects and services that plugins of several publishers are
# compiled with. PROTOS are relative to the folder `proto` beside the CMakeLists.txt, and go into the package: who builds
# with it makes the headers from them. MESSAGES are packages whose objects these use.
#
# Targets: publisher::name (the library), publisher-name-package (the .fpk; part of `all`).
function(fiona_add_messages package)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "MANIFEST;README" "PROTOS;MESSAGES")
  string(REPLACE / - name ${package})
  string(REPLACE / :: target ${package})
  fiona_find_messages(${arg_MESSAGES})
  string(REPLACE / :: needed "${arg_MESSAGES}")
  set(root ${CMAKE_CURRENT_SOURCE_DIR}/proto)
  _fiona_add_proto_root(${root})

  list(JOIN arg_PROTOS "\", \"" files)
  set(entry ${CMAKE_CURRENT_BINARY_DIR}/${name}_messages.cpp)
  file(CONFIGURE OUTPUT ${entry} @ONLY CONTENT [[
#include <fiona/messages.hpp>

extern "C" __attribute__((visibility("default"))) const fiona::MessagesEntry* fiona_messages_entry() {
  static const char* const files[] = {"@files@", nullptr};
  static const fiona::MessagesEntry entry{sizeof(fiona::MessagesEntry), fiona::kMessagesEdgeVersion, FIONA_ABI_TAG,
                                          files};
  return &entry;
}
]])
  add_library(${name} SHARED ${entry})
  add_library(${target} ALIAS ${name})
  target_link_libraries(${name} PUBLIC fiona::fiona ${needed})
  _fiona_keep_linked(${name})
  fiona_generate_protos(${name} ROOT ${root} FILES ${arg_PROTOS} PUBLIC)
  # What protobuf has registered of it stays in the process.
  target_link_options(${name} PRIVATE -Wl,-z,nodelete)
  set_target_properties(${name} PROPERTIES LIBRARY_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR} UNITY_BUILD OFF)
  _fiona_messages_of("${needed}" all)
  set_target_properties(${name} PROPERTIES FIONA_MESSAGES "${all};${target}")

  set(share ${CMAKE_CURRENT_BINARY_DIR}/${name}.share)
  set(copies)
  foreach(proto IN LISTS arg_PROTOS)
    add_custom_command(OUTPUT ${share}/proto/${proto} DEPENDS ${root}/${proto}
                       COMMAND ${CMAKE_COMMAND} -E copy ${root}/${proto} ${share}/proto/${proto} VERBATIM)
    list(APPEND copies ${share}/proto/${proto})
  endforeach()
  fiona_describe_and_pack(${name} "${arg_MANIFEST}" "${arg_README}" ${share} "${copies}" "${all}")
endfunction()

# The message packages of these targets, and those that they need, each before who needs it.
function(_fiona_messages_of targets result)
  set(all)
  foreach(target IN LISTS targets)
    get_target_property(messages ${target} FIONA_MESSAGES)
    list(APPEND all ${messages})
  endforeach()
  list(REMOVE_DUPLICATES all)
  list(FILTER all EXCLUDE REGEX "^$")
  set(${result} ${all} PARENT_SCOPE)
endfunction()

# A plugin that only requires a service finds it by its name: no symbol tells the linker that it needs the library.
function(_fiona_keep_linked target)
  target_link_options(${target} INTERFACE -Wl,--no-as-needed)
endfunction()

# What protos compiled from here on may import.
function(_fiona_add_proto_root root)
  set_property(GLOBAL APPEND PROPERTY FIONA_PROTO_ROOTS ${root})
endfunction()

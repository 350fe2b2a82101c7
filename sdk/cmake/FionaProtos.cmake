# fiona_generate_protos(TARGET ROOT dir FILES a/b.proto ... [PUBLIC])
#
# Compiles protos into TARGET: messages by protoc, service types (`a/b.fiona.hpp`) by FIONA's plugin for it. FILES are
# relative to ROOT, as imports spell them. PUBLIC: users of TARGET see the headers.
function(fiona_generate_protos target)
  cmake_parse_arguments(PARSE_ARGV 1 arg "PUBLIC" "ROOT" "FILES")
  set(out ${CMAKE_CURRENT_BINARY_DIR}/generated)
  fiona_proto_commands(ROOT ${arg_ROOT} OUT ${out} FILES ${arg_FILES} SOURCES sources)
  set_source_files_properties(${sources} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  if(FIONA_SANITIZE MATCHES undefined)
    # It is protoc's, and takes twice the time to compile so.
    set_source_files_properties(${sources} PROPERTIES COMPILE_OPTIONS -fno-sanitize=undefined)
  endif()
  target_sources(${target} PRIVATE ${sources})
  if(arg_PUBLIC)
    target_include_directories(${target} SYSTEM PUBLIC $<BUILD_INTERFACE:${out}> $<INSTALL_INTERFACE:include>)
  else()
    target_include_directories(${target} SYSTEM PRIVATE ${out})
  endif()
endfunction()

# What makes C++ of protos in the folder OUT: names of the .pb.cc in SOURCES, of the headers in HEADERS.
function(fiona_proto_commands)
  cmake_parse_arguments(PARSE_ARGV 0 arg "" "ROOT;OUT;SOURCES;HEADERS" "FILES")
  file(MAKE_DIRECTORY ${arg_OUT})
  get_property(roots GLOBAL PROPERTY FIONA_PROTO_ROOTS)
  list(PREPEND roots ${arg_ROOT})
  if(FIONA_PROTO_ROOT)
    list(APPEND roots ${FIONA_PROTO_ROOT})
  endif()
  list(REMOVE_DUPLICATES roots)
  list(TRANSFORM roots PREPEND "-I")
  set(sources)
  set(headers)
  foreach(file IN LISTS arg_FILES)
    string(REGEX REPLACE "\\.proto$" "" stem ${file})
    add_custom_command(
      OUTPUT ${arg_OUT}/${stem}.pb.cc ${arg_OUT}/${stem}.pb.h ${arg_OUT}/${stem}.fiona.hpp
      COMMAND protobuf::protoc ${roots} --cpp_out=${arg_OUT}
              --plugin=protoc-gen-fiona=$<TARGET_FILE:fiona::protoc-gen-fiona> --fiona_out=${arg_OUT} ${file}
      DEPENDS ${arg_ROOT}/${file} fiona::protoc-gen-fiona
      VERBATIM)
    list(APPEND sources ${arg_OUT}/${stem}.pb.cc)
    list(APPEND headers ${arg_OUT}/${stem}.pb.h ${arg_OUT}/${stem}.fiona.hpp)
  endforeach()
  if(arg_SOURCES)
    set(${arg_SOURCES} ${sources} PARENT_SCOPE)
  endif()
  if(arg_HEADERS)
    set(${arg_HEADERS} ${headers} PARENT_SCOPE)
  endif()
endfunction()

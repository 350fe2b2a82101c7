# fiona_generate_protos(TARGET ROOT dir FILES a/b.proto ... [PUBLIC])
#
# Compiles protos into TARGET: messages by protoc, service types (`a/b.fiona.hpp`) by FIONA's plugin for it. FILES are
# relative to ROOT, as imports spell them. PUBLIC: users of TARGET see the headers.
function(fiona_generate_protos target)
  cmake_parse_arguments(PARSE_ARGV 1 arg "PUBLIC" "ROOT" "FILES")
  set(out ${CMAKE_CURRENT_BINARY_DIR}/generated)
  file(MAKE_DIRECTORY ${out})
  set(imports -I ${arg_ROOT})
  if(FIONA_PROTO_ROOT AND NOT FIONA_PROTO_ROOT STREQUAL arg_ROOT)
    list(APPEND imports -I ${FIONA_PROTO_ROOT})
  endif()
  set(sources)
  foreach(file IN LISTS arg_FILES)
    string(REGEX REPLACE "\\.proto$" "" stem ${file})
    add_custom_command(
      OUTPUT ${out}/${stem}.pb.cc ${out}/${stem}.pb.h ${out}/${stem}.fiona.hpp
      COMMAND protobuf::protoc ${imports} --cpp_out=${out}
              --plugin=protoc-gen-fiona=$<TARGET_FILE:fiona::protoc-gen-fiona> --fiona_out=${out} ${file}
      DEPENDS ${arg_ROOT}/${file} fiona::protoc-gen-fiona
      VERBATIM)
    list(APPEND sources ${out}/${stem}.pb.cc)
    set_source_files_properties(${out}/${stem}.pb.cc PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    if(FIONA_SANITIZE MATCHES undefined)
      # It is protoc's, and takes twice the time to compile so.
      set_source_files_properties(${out}/${stem}.pb.cc PROPERTIES COMPILE_OPTIONS -fno-sanitize=undefined)
    endif()
  endforeach()
  target_sources(${target} PRIVATE ${sources})
  if(arg_PUBLIC)
    target_include_directories(${target} SYSTEM PUBLIC $<BUILD_INTERFACE:${out}> $<INSTALL_INTERFACE:include>)
  else()
    target_include_directories(${target} SYSTEM PRIVATE ${out})
  endif()
endfunction()

#pragma once

#include <google/protobuf/stubs/common.h>

#include <string>

#include "fiona/catalogue.fiona.hpp"
#include "fiona/headers.fiona.hpp"

#define FIONA_TEXT_OF(x) #x
#define FIONA_TEXT(x) FIONA_TEXT_OF(x)

/// SDK major and minor, its headers, Itanium C++ ABI version of the compiler, std::string layout, protobuf, the
/// platform's objects.
#define FIONA_ABI_TAG                                                                              \
  "fiona0.1-headers" FIONA_HEADERS "-cxxabi" FIONA_TEXT(__GXX_ABI_VERSION) "-cxx11abi" FIONA_TEXT( \
      _GLIBCXX_USE_CXX11_ABI) "-protobuf" FIONA_TEXT(GOOGLE_PROTOBUF_VERSION) "-catalogue" FIONA_CATALOGUE

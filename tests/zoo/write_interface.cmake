# Writes the interface of one plugin of the zoo; the ABI tag comes from a described plugin of the same build.
if(NOT ABI)
  file(STRINGS ${DESCRIBED} line REGEX "^abi: " LIMIT_COUNT 1)
  string(REGEX REPLACE "^abi: \"(.*)\"$" "\\1" ABI "${line}")
endif()
file(WRITE ${OUT} "abi: \"${ABI}\"\n")
foreach(component IN LISTS COMPONENTS)
  file(APPEND ${OUT} "components {
  name: \"${component}\"
  ports { name: \"${PORT}\" direction: PROVIDES service: \"fiona.localisation.StepProvider\" }
  modes { name: \"active\" }
")
  foreach(right IN LISTS RIGHTS)
    file(APPEND ${OUT} "  rights: \"${right}\"\n")
  endforeach()
  file(APPEND ${OUT} "}\n")
endforeach()

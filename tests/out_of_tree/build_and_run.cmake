# Installs the SDK, builds the stranger's project with it, runs its test, and runs a system of its one component.
function(run)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE code OUTPUT_VARIABLE said ERROR_VARIABLE said)
  if(NOT code EQUAL 0)
    list(JOIN ARGN " " line)
    message(FATAL_ERROR "${line}\nended with ${code}:\n${said}")
  endif()
endfunction()

file(REMOVE_RECURSE ${WORK})
set(prefix ${WORK}/prefix)
run(${CMAKE_COMMAND} --install ${BUILD} --prefix ${prefix} --component sdk)
if(SANITIZE)
  set(flags -DCMAKE_CXX_FLAGS=-fsanitize=${SANITIZE})
endif()
run(${CMAKE_COMMAND} -S ${PROJECT} -B ${WORK}/build -G ${GENERATOR} -DCMAKE_PREFIX_PATH=${prefix} -DCMAKE_BUILD_TYPE=Debug
    -DCMAKE_CXX_COMPILER=${COMPILER} -DCMAKE_CXX_COMPILER_LAUNCHER=${LAUNCHER} ${flags})
run(${CMAKE_COMMAND} --build ${WORK}/build)
run(${CMAKE_CTEST_COMMAND} --test-dir ${WORK}/build --output-on-failure --no-tests=error)
foreach(product libbeeper.so beeper.interface.textproto beeper.fpk)
  if(NOT EXISTS ${WORK}/build/${product})
    message(FATAL_ERROR "the build made no ${product}")
  endif()
endforeach()

# The programs bring a marketplace, and whoever installs them has said that they trust it.
run(${CMAKE_COMMAND} --install ${BUILD} --prefix ${WORK}/whole)
run(${CMAKE_COMMAND} -E env --unset=FIONA_MARKET --unset=XDG_DATA_HOME --unset=XDG_CACHE_HOME --unset=XDG_CONFIG_HOME
    HOME=${WORK}/home FIONA_STORE=${WORK}/store-of-whole ${WORK}/whole/bin/fiona market install building-simulator -q)

# Sockets have short names, and their folder is the user's alone.
execute_process(COMMAND mktemp -d OUTPUT_VARIABLE runtime OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
file(WRITE ${WORK}/beeper.fiona "load \"${WORK}/build/libbeeper.so\" as beeper beeps=3 pause=2ms\n")
set(ENV{XDG_RUNTIME_DIR} ${runtime})
set(ENV{FIONA_STORE} ${WORK}/store)
execute_process(COMMAND ${BUILD}/bin/fiona run ${WORK}/beeper.fiona --headless TIMEOUT 60
                RESULT_VARIABLE code OUTPUT_VARIABLE said ERROR_VARIABLE said)
file(REMOVE_RECURSE ${runtime})
if(NOT code EQUAL 0)
  message(FATAL_ERROR "the system of the beeper ended with ${code}:\n${said}")
endif()

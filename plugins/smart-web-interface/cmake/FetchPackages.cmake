# Fetches the packages of the lock file into TO, none of whose scripts is run; says what to do where that fails.
file(MAKE_DIRECTORY ${TO})
file(COPY ${FROM}/package.json ${FROM}/package-lock.json ${FROM}/.npmrc DESTINATION ${TO})
execute_process(COMMAND ${NPM} ci --ignore-scripts --prefer-offline --no-audit --no-fund --loglevel=error
                        --fetch-retries=1 --fetch-timeout=60000
                WORKING_DIRECTORY ${TO} RESULT_VARIABLE result OUTPUT_VARIABLE said ERROR_VARIABLE said)
if(NOT result EQUAL 0)
  message(FATAL_ERROR "npm could not fetch what the page of smart-web-interface is built with:\n${said}\n"
          "It needs a way to npm's registry, or its cache from an earlier build. "
          "To build everything but this plugin: cmake -DFIONA_WEB=OFF")
endif()

// What most plugins of the zoo are: a component that provides steps, sound but for what it does at one of these. A
// plugin defines those at which it misbehaves; the others do nothing.
#pragma once

namespace zoo {

void construct();  ///< in the constructor
void start();      ///< in on_start
void act();        ///< in a timer, 20 ms after it became active
void stop();       ///< in on_stop
void destroy();    ///< in the destructor

/// [act] A line of its log.
void log(const char* line);

/// [act] Ends the run, as a component may that plays a recording.
void end_run();

/// Keeps the optimiser from knowing that a loop is never left.
inline volatile bool for_ever = true;

}  // namespace zoo

/// The component's, which is the library's.
#ifdef ZOO_NAME
extern "C" [[gnu::used, gnu::weak]] const char* zoo_name() { return ZOO_NAME; }
#else
extern "C" const char* zoo_name();
#endif

#pragma once

#include "../session.hpp"

/// The handlers of the table of verbs: each does what one line asks, or throws fiona::Error.
namespace fiona::console::verbs {

void load(Session& session, const Line& line);
void unload(Session& session, const Line& line);
void wire(Session& session, const Line& line);
void unwire(Session& session, const Line& line);
void swap(Session& session, const Line& line);
void upgrade(Session& session, const Line& line);
void begin(Session& session, const Line& line);
void commit(Session& session, const Line& line);
void abort(Session& session, const Line& line);
void plan(Session& session, const Line& line);
void apply(Session& session, const Line& line);
void undo(Session& session, const Line& line);
void journal(Session& session, const Line& line);
void set(Session& session, const Line& line);
void get(Session& session, const Line& line);
void state(Session& session, const Line& line);
void call(Session& session, const Line& line);
void ls(Session& session, const Line& line);
void show(Session& session, const Line& line);
void spots(Session& session, const Line& line);
void why(Session& session, const Line& line);
void watch(Session& session, const Line& line);
void record(Session& session, const Line& line);
void graph(Session& session, const Line& line);
void top(Session& session, const Line& line);
void check(Session& session, const Line& line);
void run(Session& session, const Line& line);
void save(Session& session, const Line& line);
void source(Session& session, const Line& line);
void wait(Session& session, const Line& line);
void expect(Session& session, const Line& line);
void sleep(Session& session, const Line& line);
void quit(Session& session, const Line& line);
void market(Session& session, const Line& line);
void plugin(Session& session, const Line& line);
void keys(Session& session, const Line& line);
void complete(Session& session, const Line& line);
void doctor(Session& session, const Line& line);
void help(Session& session, const Line& line);
void paths(Session& session, const Line& line);
void version(Session& session, const Line& line);

}  // namespace fiona::console::verbs

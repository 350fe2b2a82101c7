#pragma once

namespace fiona::os {

/// [before the first thread] From now on, whoever connects while the process has no descriptor left is turned away, and
/// nobody else notices: one is kept to accept them with. Otherwise what listens would be told again and again that
/// somebody waits, and ZeroMQ's listener on unix sockets would abort the process.
///
/// So `accept4`, which ZeroMQ calls too, is defined here for the whole program.
void keep_spare_descriptor();

}  // namespace fiona::os

#include "masters.hpp"

#include "access.hpp"
#include "failure.hpp"
#include "fiona/error.hpp"

namespace fiona::host {

void Masters::serve(const wire::Asked& asked) {
  if (!system_.has_asked(asked)) return;  // somebody speaks in another's name, or has gone, or asks another host
  try {
    require_right(asked.instance());
    const Rights rights{trust::Access::Compose, trust::Access::Compose, asked.instance()};
    require(rights, asked.request());
    perform(asked, rights);
  } catch (...) {
    control::Reply reply;
    *reply.mutable_failure() = failure_of_exception();
    answer(asked, std::move(reply));
  }
}

void Masters::require_right(const std::string& name) const {
  const Model::Instance& one = system_.model().instance(name);
  if (one.is_master()) return;
  throw Error(ErrorCode::NotAllowed,
              {.what = "'" + name + "' has not been granted the right 'master'",
               .where = name,
               .next = "unload " + name + ", then: load " + one.plugin + " as " + name + " with master"});
}

void Masters::perform(const wire::Asked& asked, const Rights& rights) {
  const control::Request& request = asked.request();
  if (request.has_snapshot()) {
    control::Reply reply;
    *reply.mutable_system() = system_.snapshot();
    reply.mutable_system()->clear_interfaces();
    return answer(asked, std::move(reply));
  }
  if (!request.has_transact()) {
    throw Error(ErrorCode::NotAllowed,
                {.what = "a component may ask for changes and for the system as it is, and no more",
                 .where = asked.instance(),
                 .next = "let a console do it"});
  }
  std::optional<std::chrono::milliseconds> within;
  if (request.deadline_ms() > 0) within = std::chrono::milliseconds(request.deadline_ms());
  const auto ended = [later = later_, alive = std::weak_ptr(self_), asked](control::Reply reply) {
    later([alive, asked, reply = std::move(reply)] {
      const auto self = alive.lock();
      if (self && *self) (*self)->answer(asked, reply);
    });
  };
  engine_.transact("component " + asked.instance(), request.transact(), ended, within, rights);
}

void Masters::answer(const wire::Asked& asked, control::Reply reply) { system_.answer(asked, reply); }

}  // namespace fiona::host

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
  using Request = control::Request;
  control::Reply reply;
  switch (asked.request().what_case()) {
    case Request::kTransact: return transact(asked, rights);
    case Request::kSnapshot:
      *reply.mutable_system() = system_.snapshot();
      reply.mutable_system()->clear_interfaces();
      break;
    case Request::kRead:
      *reply.mutable_sample() = sample_of(system_.read(asked.request().read().probe()), system_.clock().start());
      break;
    case Request::kWatch:
      watches_.watch(asked);
      reply.mutable_done();
      break;
    case Request::kNext:
      if (auto next = watches_.next(asked)) return answer(asked, *std::move(next));
      return;
    case Request::kUnwatch:
      watches_.unwatch(asked.instance(), asked.request().unwatch().watch());
      reply.mutable_done();
      break;
    default:
      throw Error(
          ErrorCode::NotAllowed,
          {.what = "a component may ask for changes, for the system as it is, and for what there is to be seen of it",
           .where = asked.instance(),
           .next = "let a console do it"});
  }
  answer(asked, std::move(reply));
}

void Masters::transact(const wire::Asked& asked, const Rights& rights) {
  const control::Request& request = asked.request();
  std::optional<std::chrono::milliseconds> within;
  if (request.deadline_ms() > 0) within = std::chrono::milliseconds(request.deadline_ms());
  // Each life counts its requests from 1: to the one after it the answer would be that to a request of its own.
  const auto ended = [later = later_, alive = std::weak_ptr(self_), asked,
                      life = system_.life_of(asked.instance())](control::Reply reply) {
    later([alive, asked, life, reply = std::move(reply)] {
      const auto self = alive.lock();
      if (self && *self && (*self)->system_.life_of(asked.instance()) == life) (*self)->answer(asked, reply);
    });
  };
  engine_.transact("component " + asked.instance(), request.transact(), ended, within, rights);
}

void Masters::answer(const wire::Asked& asked, control::Reply reply) { system_.answer(asked, reply); }

}  // namespace fiona::host

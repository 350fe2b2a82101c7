#pragma once

#include <coroutine>
#include <exception>
#include <optional>
#include <utility>

namespace fiona {

/// A coroutine of a component: a handler that waits for answers without blocking a thread.
///
///     fiona::Async<> on_destination(const CommDestination& to) {
///       auto plan = co_await planner_.query(request_for(to));   // other ports' handlers may run meanwhile
///       if (plan) path_.put(to_path(*plan));
///     }
///
/// It starts when it is first awaited (the hull does so for a handler), runs on the instance's strand throughout,
/// and is destroyed with the instance if it has not ended by then. An exception that leaves it reaches who awaits it.
template <class T = void>
class [[nodiscard]] Async;

namespace detail {

/// [strand] The exception that is being handled. Does not return where that is no exception but the end of the thread.
std::exception_ptr exception_of_coroutine();

struct AsyncPromiseBase {
  std::coroutine_handle<> continuation = std::noop_coroutine();
  std::exception_ptr error;

  struct FinalAwaiter {
    bool await_ready() const noexcept { return false; }
    template <class P>
    std::coroutine_handle<> await_suspend(std::coroutine_handle<P> self) const noexcept {
      return self.promise().continuation;
    }
    void await_resume() const noexcept {}
  };
  std::suspend_always initial_suspend() const noexcept { return {}; }
  FinalAwaiter final_suspend() const noexcept { return {}; }
  void unhandled_exception() { error = exception_of_coroutine(); }
};

template <class T>
struct AsyncPromise : AsyncPromiseBase {
  std::optional<T> value;
  Async<T> get_return_object();
  template <class U>
  void return_value(U&& result) {
    value.emplace(std::forward<U>(result));
  }
  T take() {
    if (error) std::rethrow_exception(error);
    return std::move(*value);
  }
};

template <>
struct AsyncPromise<void> : AsyncPromiseBase {
  Async<void> get_return_object();
  void return_void() {}
  void take() const {
    if (error) std::rethrow_exception(error);
  }
};

}  // namespace detail

template <class T>
class [[nodiscard]] Async {
 public:
  using promise_type = detail::AsyncPromise<T>;
  using Handle = std::coroutine_handle<promise_type>;

  explicit Async(Handle handle) : handle_(handle) {}
  Async(Async&& other) noexcept : handle_(std::exchange(other.handle_, {})) {}
  Async& operator=(Async&& other) noexcept {
    std::swap(handle_, other.handle_);
    return *this;
  }
  ~Async() {
    if (handle_) handle_.destroy();
  }

  struct Awaiter {
    Handle handle;
    bool await_ready() const noexcept { return handle.done(); }
    std::coroutine_handle<> await_suspend(std::coroutine_handle<> caller) const noexcept {
      handle.promise().continuation = caller;
      return handle;
    }
    T await_resume() const { return handle.promise().take(); }
  };
  Awaiter operator co_await() const noexcept { return Awaiter{handle_}; }

  /// Starts a coroutine that nobody awaits; it runs to its first suspension. For hulls, not for components.
  void start() const { handle_.resume(); }
  bool done() const { return handle_.done(); }

 private:
  Handle handle_;
};

namespace detail {

template <class T>
Async<T> AsyncPromise<T>::get_return_object() {
  return Async<T>(std::coroutine_handle<AsyncPromise<T>>::from_promise(*this));
}
inline Async<void> AsyncPromise<void>::get_return_object() {
  return Async<void>(std::coroutine_handle<AsyncPromise<void>>::from_promise(*this));
}

}  // namespace detail
}  // namespace fiona

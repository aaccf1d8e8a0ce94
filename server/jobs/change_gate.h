// Changes of scenes wait here while another daemon takes the state folder over.
#pragma once

#include "server/ground/waiters.h"
#include "server/store/state_folder.h"

#include <memory>
#include <string_view>
#include <utility>

namespace raynest::server {

/// The error of a failed change of the state folder for its client: once another daemon has the
/// folder, one to ask that daemon for.
[[nodiscard]] inline tl::unexpected<protocol::Error> not_changed(const StateFolder& state,
                                                                 Error why) {
    if (!state.is_closed()) return refuse(std::move(why));
    return refuse(Code::draining, std::move(why.message));
}

/// Io thread only.
class ChangeGate {
public:
    using Awake = Waiters::Awake;

    /// True for jobs that change stored scenes.
    [[nodiscard]] static bool concerns(std::string_view kind) {
        return kind == "load" || kind == "edit" || kind == "unload" || kind == "pin" ||
               kind == "restore";
    }
    [[nodiscard]] bool is_closed() const { return closed_; }
    void close() { closed_ = true; }
    /// Those who wait go on, in turns that `post` queues.
    void open(const Post& post) {
        closed_ = false;
        waiting_.wake_all({}, post);
    }
    /// Calls `awake` once the gate is open, unless it has expired.
    void wait(std::weak_ptr<Awake> awake) { waiting_.add(std::move(awake)); }

private:
    bool closed_ = false;
    Waiters waiting_;
};

}  // namespace raynest::server

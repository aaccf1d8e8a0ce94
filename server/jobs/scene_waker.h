// Brings scenes that are on the disk alone back into memory, for the requests that need them.
#pragma once

#include "server/ground/waiters.h"
#include "server/jobs/services.h"
#include "server/store/scene_store.h"

#include <functional>
#include <map>
#include <memory>
#include <string>

namespace raynest::server {

/// Reads each scene once, however many requests wait for it. Io thread only.
class SceneWaker {
public:
    /// Gets the error of a scene that could not be read, or nothing.
    using Awake = Waiters::Awake;

    /// `post` runs a function on the io thread. `services` outlives this.
    SceneWaker(const Services& services, Post post) : services_(services), post_(std::move(post)) {}
    SceneWaker(const SceneWaker&) = delete;

    /// Reads a scene in a task of `principal`, then calls `awake` unless it has expired. A damaged
    /// scene is no error here: find() tells of it.
    void wake(const AsleepScene& scene, const std::string& principal, std::weak_ptr<Awake> awake);
    /// Reads a scene at the start. No request waits for it, and no other scene leaves the memory.
    void wake(const AsleepScene& scene);
    /// Ends what nobody waits for any more: kept edits may take long.
    void drop_deserted();
    /// Ends all that runs.
    void stop();

private:
    struct Read;
    struct Waiting {
        Waiters who;
        std::shared_ptr<Read> read = nullptr;  ///< what runs
        bool for_nobody = false;               ///< goes on though nobody waits
    };
    void add(const AsleepScene& scene, const std::string& principal);
    void done(const AsleepScene& scene, Read& read);

    const Services& services_;
    const Post post_;
    std::map<std::string, Waiting> waiting_;  ///< by SceneFacts::arena
    bool is_ending_ = false;                  ///< stop() was called
};

}  // namespace raynest::server

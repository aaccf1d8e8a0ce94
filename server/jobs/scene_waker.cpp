#include "server/jobs/scene_waker.h"

#include "engine/scene/snapshot.h"
#include "server/ground/limited_log.h"
#include "server/ground/metrics.h"
#include "server/jobs/edit_memory.h"
#include "server/jobs/edit_rows.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/scheduling/peers.h"
#include "server/store/state_folder.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <optional>
#include <utility>

namespace raynest::server {

namespace {

/// For others than the owner: what it holds, and the names of that, are its own.
tl::unexpected<protocol::Error> owners_memory_is_full(const AsleepScene& scene) {
    return refuse(Code::resource_exhausted, "the scene is on the disk, and the memory of " +
                                                scene.owner + ", who has loaded it, is full: ask " +
                                                scene.owner +
                                                " to unload scenes, or try again later");
}

}  // namespace

/// The result of a task.
struct SceneWaker::Read {
    /// Reads the blob, then makes the edits again that were kept since. Blocks.
    void read(StateFolder& state, Budget& budget, const AsleepScene& scene) {
        auto stored =
            read_stored(state.path(), scene.row.digest, scene.row.bytes, scene.row.content);
        if (!stored) {
            fault = std::move(stored.error());
            if (fault->damaged && !fault->of_another_release)
                state.set_aside(scene.row.digest, fault->inode);
            return;
        }
        if (!scene.has_edits) {
            snapshot = std::move(*stored);
            return;
        }
        const auto edits = state.edits(scene.row.number);
        EditMemory memory(budget, scene.owner, Use::lasting);
        auto edited = edits ? replay_edits(std::move(*stored), scene.row.epoch, *edits,
                                           memory.guard([this] { return is_stopped.load(); }))
                            : refuse(edits.error());
        if (edited && gives(**edited, scene.facts.digest))
            snapshot = std::move(*edited);
        else
            fault = BlobFault{.damaged = !edited && edited.error().code == Code::scene_invalid,
                              .why = edited ? "its edits are gone" : edited.error().message,
                              .of_edits = true};
    }

    std::atomic<bool> is_stopped = false;  ///< by the io thread
    Budget::Lease lease;
    std::shared_ptr<const Snapshot> snapshot;
    std::optional<BlobFault> fault;
    double seconds = 0;
};

void SceneWaker::wake(const AsleepScene& scene, const std::string& principal,
                      std::weak_ptr<Awake> awake) {
    waiting_[scene.facts.arena].who.add(std::move(awake));
    add(scene, principal);
}

void SceneWaker::wake(const AsleepScene& scene) {
    waiting_[scene.facts.arena].for_nobody = true;
    add(scene, scene.owner);
}

void SceneWaker::drop_deserted() {
    for (auto& [arena, waiting] : waiting_)
        if (!waiting.for_nobody && waiting.who.all_expired()) waiting.read->is_stopped = true;
}

void SceneWaker::stop() {
    is_ending_ = true;
    for (auto& [arena, waiting] : waiting_) waiting.read->is_stopped = true;
}

void SceneWaker::add(const AsleepScene& scene, const std::string& principal) {
    Waiting& waiting = waiting_[scene.facts.arena];
    if (waiting.read) return;
    auto read = std::make_shared<Read>();
    // Edits are made beside the scene that they change. Those that change what lies within an instance
    // ask for up to two copies more once they are read.
    const std::uint64_t bytes = scene.facts.bytes + (scene.has_edits ? scene.row.bytes : 0);
    // Each call looks at all scenes. Pinned ones are read at the start, when none is in memory yet.
    if (!waiting.for_nobody) {
        services_.scenes.make_room(bytes, scene.owner);
        if (scene.has_edits) services_.scenes.make_room(bytes + 2 * scene.facts.bytes, scene.owner);
    }
    auto lease = services_.peers.reserve(bytes, scene.owner, Use::lasting);
    if (!lease) {
        Waiters who = waiting_.extract(scene.facts.arena).mapped().who;
        if (who.empty()) return;
        const auto full =
            principal == scene.owner
                ? services_.budget.refuse(
                      "the scene", bytes, scene.owner,
                      services_.scenes.remedy(scene.owner, "start raynestd with a larger --memory"))
                : owners_memory_is_full(scene);
        who.wake_all(Reply<void>(full), post_);
        return;
    }
    read->lease = std::move(*lease);
    waiting.read = read;
    services_.disk->submit(principal, Priority::normal, [this, scene, read] {
        const auto began = std::chrono::steady_clock::now();
        try {
            read->read(*services_.state, services_.budget, scene);
        } catch (const std::exception& error) {
            read->fault = BlobFault{false, error.what()};
        }
        read->seconds =
            std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
        post_([this, scene, read] { done(scene, *read); });
    });
}

void SceneWaker::done(const AsleepScene& scene, Read& read) {
    read.lease = {};
    Reply<void> result;
    if (read.snapshot) {
        result = services_.scenes.wake(std::move(read.snapshot), scene);
        if (!result) result = owners_memory_is_full(scene);  // for all who wait
        log_limited(LogLevel::info, "scene_read", scene.owner,
                    {{"hash", scene.facts.digest},
                     {"bytes", std::to_string(scene.facts.bytes)},
                     {"seconds", std::to_string(read.seconds)}});
    } else if (read.fault && read.fault->damaged) {
        // One content may have many names.
        constexpr std::size_t logged_max = 16;
        const auto names = services_.scenes.quarantine(scene.facts.arena, *read.fault);
        services_.metrics.count<&Metrics::scenes_damaged>(scene.owner, names.size());
        for (std::size_t i = 0; i < std::min(names.size(), logged_max); ++i)
            log(LogLevel::error, "scene_damaged",
                {{"scene", names[i]},
                 {"hash", scene.facts.digest},
                 {"blob", scene.row.digest},
                 {"reason", read.fault->why},
                 {"remedy",
                  read.fault->of_another_release
                      ? "load it again, or start that release"
                      : "load it again; the bytes are in the folder damaged of --state"}});
        if (names.size() > logged_max)
            log(LogLevel::error, "scenes_damaged",
                {{"hash", scene.facts.digest},
                 {"more_names", std::to_string(names.size() - logged_max)}});
    } else if (!read.is_stopped || is_ending_) {
        result = refuse(Code::resource_exhausted,
                        "the stored scene could not be read: " + read.fault->why + "; try again");
    }
    // Requests that have come since nobody waited any more ask again.
    auto waiting = waiting_.extract(scene.facts.arena);
    if (!waiting.empty()) waiting.mapped().who.wake_all(std::move(result), post_);
}

}  // namespace raynest::server

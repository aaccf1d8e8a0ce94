// Views of scenes in which parts are hidden, kept for the next request that hides the same.
#pragma once

#include "server/execution/selected.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/store/named_scene.h"

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <string>

namespace raynest::server {

/// Keeps the last few of each principal for a while. They count towards --memory as requests of the
/// principal do. Io thread only.
class KeptSelections {
public:
    /// The last ones of each principal.
    static constexpr std::size_t kept_max = 4;
    static constexpr std::chrono::seconds kept_time{20};

    /// Selections that are dropped end on a thread of `pool`, which outlives this.
    explicit KeptSelections(FairThreadPool& pool) : pool_(pool) {}
    KeptSelections(const KeptSelections&) = delete;
    ~KeptSelections() = default;

    /// Returns the view of a scene for these words; null if none is kept.
    [[nodiscard]] std::shared_ptr<Selected> find(const std::string& principal,
                                                 const std::shared_ptr<const HeldScene>& scene,
                                                 const SelectionWords& words);
    void keep(const std::string& principal, const std::shared_ptr<const HeldScene>& scene,
              std::shared_ptr<Selected> selected);
    /// Frees what no request of the principal uses.
    void drop(const std::string& principal);
    /// Frees what nobody has used for kept_time, and what is of scenes that are gone.
    void drop_idle();
    /// Returns how many bytes of --memory are kept for a principal and used by no request.
    [[nodiscard]] std::uint64_t held_by(const std::string& principal) const;

private:
    using Clock = std::chrono::steady_clock;
    struct Kept {
        std::weak_ptr<const HeldScene> scene;
        std::shared_ptr<Selected> selected;
        Clock::time_point used = Clock::now();
    };
    using List = std::list<Kept>;  ///< the last one used in front

    List::iterator drop(const std::string& principal, List& list, List::iterator kept);

    FairThreadPool& pool_;
    std::map<std::string, List> kept_;  ///< by principal
};

}  // namespace raynest::server

#include "engine/scene/edits/uid_finder.h"

#include "engine/scene/content.h"
#include "engine/scene/edits/covered.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <map>
#include <memory>
#include <utility>

namespace raynest {
namespace {

using Places = std::vector<std::vector<InstancePlace>>;

/// Finds instances whose own id is sought. The scene's nodes have none.
class OwnUids {
public:
    OwnUids(const Snapshot& scene, std::span<const std::uint32_t> uids,
            const std::function<bool()>& stopped)
        : scene_(scene),
          view_(scene.view()),
          uids_(uids),
          stopped_(stopped),
          leads_to_one_(view_.object_count),
          above_(uids.size()),
          found_(uids.size()) {}

    Result<Places> find() {
        // Children are stored before their parents.
        for (std::uint32_t i = 0; i < view_.object_count; ++i) {
            if (i % 1024 == 0 && stopped_()) return fail(ErrorCode::limit_exceeded, "stopped");
            const ObjectRecord& object = view_.objects[i];
            if (object.instance_count >= UidIndices::steps_min) {
                const auto index = index_of(i);
                auto places = places_in(*index);
                if (!places) return tl::unexpected(places.error());
                places_here_[i] = std::move(*places);
                leads_to_one_[i] = !places_here_[i].empty() || leads_below(*index);
                continue;
            }
            for (std::uint32_t k = 0; k < object.instance_count && !leads_to_one_[i]; ++k) {
                const std::uint32_t at = object.first_instance + k;
                leads_to_one_[i] =
                    number_of(at) != uids_.size() || leads_to_one_[view_.instances[at].object];
            }
        }
        if (auto entered = enter(view_.root); !entered) return tl::unexpected(entered.error());
        return std::move(found_);
    }

private:
    [[nodiscard]] std::shared_ptr<const UidIndex> index_of(std::uint32_t object) const {
        return scene_.uids().of(object, [&] { return UidIndex(view_, view_.objects[object]); });
    }
    /// True if something that the instances place leads to one that is sought.
    [[nodiscard]] bool leads_below(const UidIndex& index) const {
        return std::ranges::any_of(index.objects(),
                                   [&](std::uint32_t object) { return leads_to_one_[object]; });
    }
    /// Returns the instances of an index that are sought, ascending.
    [[nodiscard]] Result<std::vector<std::uint32_t>> places_in(const UidIndex& index) const {
        std::vector<std::uint32_t> places;
        for (std::size_t i = 0; i < uids_.size(); ++i) {
            if (i % 1024 == 0 && stopped_()) return fail(ErrorCode::limit_exceeded, "stopped");
            index.find(uids_[i], places);
        }
        std::ranges::sort(places);
        return places;
    }

    /// Returns the place of an instance's id among those that are sought, or their count.
    [[nodiscard]] std::size_t number_of(std::uint32_t instance) const {
        const std::uint32_t uid = view_.instance_infos[instance].uid;
        const auto at = std::ranges::lower_bound(uids_, uid);
        return at != uids_.end() && *at == uid ? static_cast<std::size_t>(at - uids_.begin())
                                               : uids_.size();
    }

    Result<void> enter(std::uint32_t object) {
        if (!leads_to_one_[object]) return {};
        const ObjectRecord& record = view_.objects[object];
        const auto here = places_here_.find(object);
        const bool all = here == places_here_.end() || leads_below(*index_of(object));
        const std::size_t count = all ? record.instance_count : here->second.size();
        for (std::size_t k = 0; k < count; ++k) {
            const std::uint32_t i = all ? static_cast<std::uint32_t>(k) : here->second[k];
            if (k % 1024 == 0 && stopped_()) return fail(ErrorCode::limit_exceeded, "stopped");
            if (!way_.empty() && ++looked_at_ > uid_instances_max)
                return fail(ErrorCode::limit_exceeded,
                            fmt::format("the user ids may stand for more than {} instances within "
                                        "others: name the paths",
                                        uid_instances_max));
            const std::uint32_t at = record.first_instance + i;
            const std::size_t number = number_of(at);
            way_.push_back(i);
            if (number != uids_.size() && above_[number]++ == 0)
                found_[number].emplace_back(way_.front(),
                                            std::vector(way_.begin() + 1, way_.end()));
            const auto entered = enter(view_.instances[at].object);
            if (number != uids_.size()) --above_[number];
            way_.pop_back();
            if (!entered) return entered;
        }
        return {};
    }

    const Snapshot& scene_;
    const SceneView& view_;
    const std::span<const std::uint32_t> uids_;
    const std::function<bool()>& stopped_;
    std::map<std::uint32_t, std::vector<std::uint32_t>>
        places_here_;                 ///< by object with a long list: its instances that are sought
    std::vector<bool> leads_to_one_;  ///< by object: it places an instance that is sought
    std::vector<std::uint32_t> above_;  ///< by id: how many on the way have it
    std::vector<std::uint32_t> way_;
    std::uint64_t looked_at_ = 0;  ///< nested instances
    Places found_;
};

/// Finds instances whose placements are all those of a node, or below it, whose id is sought.
class NodeUids {
public:
    NodeUids(const Snapshot& scene, std::span<const std::uint32_t> uids,
             const std::function<bool()>& stopped)
        : scene_(scene),
          paths_(scene.paths()),
          uids_(uids),
          stopped_(stopped) {}

    Result<Places> find() {
        const auto ranges = ranges_by_uid();
        if (!ranges) return tl::unexpected(ranges.error());
        Places found(uids_.size());
        CoveredInstances covered(scene_, uid_instances_max);
        for (std::size_t number = 0; number < uids_.size(); ++number)
            for (const Range& range : (*ranges)[number]) {
                if (stopped_()) return fail(ErrorCode::limit_exceeded, "stopped");
                if (!covered.find(range, range.steps, found[number])) return too_many();
            }
        return found;
    }

private:
    struct Range : PathRange {
        std::size_t steps = 0;  ///< steps in the text of the node; of several, the fewest
    };

    /// Returns the paths of each id, those that follow each other in one range.
    Result<std::vector<std::vector<Range>>> ranges_by_uid() {
        constexpr std::uint32_t none = ~0U;
        // By node: the next one upwards, itself included, whose id is sought, and the number of it.
        struct Sought {
            std::uint32_t node = none, number = none;
        };
        std::vector<Sought> sought(paths_.node_count);
        std::vector<std::uint32_t> steps(paths_.node_count);
        for (std::uint32_t i = 1; i < paths_.node_count; ++i) {
            steps[i] = steps[paths_.nodes[i].parent] + 1;
            const auto at = std::ranges::lower_bound(uids_, paths_.nodes[i].source);
            sought[i] = at != uids_.end() && *at == paths_.nodes[i].source
                            ? Sought{i, static_cast<std::uint32_t>(at - uids_.begin())}
                            : sought[paths_.nodes[i].parent];
        }
        std::vector<std::vector<Range>> ranges(uids_.size());
        for (std::uint32_t r = 0; r < paths_.run_count; ++r) {
            if (r % 1024 == 0 && stopped_()) return fail(ErrorCode::limit_exceeded, "stopped");
            const PathRange run{paths_.runs[r].first_path,
                                end_of_run(paths_, r, scene_.statistics().instances)};
            Sought next = sought[paths_.runs[r].node];
            for (; next.node != none; next = sought[paths_.nodes[next.node].parent]) {
                std::vector<Range>& of = ranges[next.number];
                if (!of.empty() && of.back().end >= run.first) {
                    of.back().end = run.end;
                    of.back().steps = std::min<std::size_t>(of.back().steps, steps[next.node]);
                } else {
                    of.push_back({run, steps[next.node]});
                }
                if (++looked_at_ > uid_instances_max + paths_.run_count) return too_many();
            }
        }
        return ranges;
    }

    static tl::unexpected<Error> too_many() {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("the user ids may stand for more than {} placements: name the "
                                "paths",
                                uid_instances_max));
    }

    const Snapshot& scene_;
    const PathTable& paths_;
    const std::span<const std::uint32_t> uids_;
    const std::function<bool()>& stopped_;
    std::uint64_t looked_at_ = 0;  ///< runs, for each id that they have
};

}  // namespace

Result<std::vector<std::vector<InstancePlace>>> find_uids(const Snapshot& scene,
                                                          std::span<const std::uint32_t> uids,
                                                          const std::function<bool()>& stopped) {
    return scene.paths().node_count == 0 ? OwnUids(scene, uids, stopped).find()
                                         : NodeUids(scene, uids, stopped).find();
}

}  // namespace raynest

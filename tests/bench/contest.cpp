#include "tests/bench/contest.h"

#include "tests/bench/files.h"
#include "tests/bench/mask_border.h"
#include "tests/bench/rays.h"
#include "tests/bench/report.h"
#include "tests/bench/side.h"

#include <algorithm>
#include <iostream>
#include <map>
#include <set>
#include <tuple>
#include <utility>

namespace raynest::bench {
namespace {

bool contains(const std::vector<std::string>& list, const std::string& name) {
    return std::find(list.begin(), list.end(), name) != list.end();
}

struct RayMask {
    std::vector<Ray> rays;
    Query query;
};

Result<RayMask> prepare_rays(const Options& options, const Loaded& loaded,
                             const std::string& name) {
    RayMask set{{}, query_closest};
    if (name.ends_with(".rays")) {
        auto read = read_rays(name);
        if (!read) return tl::unexpected(read.error());
        set.rays = std::move(*read);
    } else {
        const auto kind = parse_ray_kind(name);
        if (!kind) return tl::unexpected(kind.error());
        const auto opaque =
            loaded.registries.front()->choose("opaque", loaded.workload.scene->view());
        if (!opaque) return tl::unexpected(opaque.error());
        const auto finder = find_function(**opaque, query_closest, traversal_single);
        if (!finder) return tl::unexpected(finder.error());
        set.rays = make_rays(loaded.workload, *kind, options.count, *finder);
        set.query = natural_query(*kind);
    }
    if (set.rays.empty()) return fail(ErrorCode::param_invalid, "no rays of kind " + name);
    if (options.kind != "auto") {
        const auto query = parse_query(options.kind);
        if (!query) return tl::unexpected(query.error());
        set.query = *query;
    }
    return set;
}

/// The sides of one set of rays.
class Sides {
public:
    Sides(const Options& options, Loaded& loaded, const RayMask& set)
        : options_(options),
          loaded_(loaded),
          set_(set),
          hits_max_(set.query == query_multi ? options.hits_max : 1) {}

    Result<std::vector<Side>> make() {
        for (const unsigned threads : options_.threads) {
            if (auto added = add_own(loaded_.workload, threads); !added) {
                return tl::unexpected(added.error());
            }
        }
        if (sides_.empty()) {
            return fail(ErrorCode::variant_unknown, "none of the variants asked for is compiled");
        }
        if (loaded_.over) {
            if (auto added = add_own(*loaded_.over, 1); !added) {
                return tl::unexpected(added.error());
            }
        }
        if (auto added = add_peers(); !added) return tl::unexpected(added.error());
        return std::move(sides_);
    }

private:
    Result<void> add_own(const Workload& workload, unsigned threads) {
        for (const auto& registry : loaded_.registries) {
            for (const std::string& intersector : options_.intersectors) {
                const auto variant = registry->choose(intersector, workload.scene->view());
                if (!variant) return tl::unexpected(variant.error());
                if (auto added = add_traversals(workload, **variant, threads); !added) return added;
            }
        }
        return {};
    }

    Result<void> add_traversals(const Workload& workload, const Variant& variant,
                                unsigned threads) {
        for (const std::string& traversal : options_.traversals) {
            for (const std::string& counters : options_.counters) {
                Label label{"own", traversal, variant.name, counters, variant.target, threads};
                if (auto added = add_variant(workload, variant, std::move(label)); !added)
                    return added;
            }
        }
        return {};
    }

    Result<void> add_variant(const Workload& workload, const Variant& variant, Label label) {
        const auto traversal = parse_traversal(label.traversal);
        if (!traversal) return tl::unexpected(traversal.error());
        const auto selector =
            KernelSelector::make(variant, set_.query, *traversal, counter_mode(label.counters));
        // Where single rays stand in for what was named, a row of that name would be theirs.
        const bool stands =
            selector && (*traversal == traversal_auto ||
                         selector->choose({}, workload.scene->view()) == *traversal);
        if (!stands) {
            static std::set<std::string> said;
            const std::string skipped =
                variant.name + ", " + label.traversal + " on " + variant.target;
            if (said.insert(skipped).second) {
                std::cerr << "raynest-bench: skipped, not compiled: " << skipped << "\n";
            }
            return {};
        }
        Side side =
            make_own_side(std::move(label), workload, *selector, set_.rays, set_.query, hits_max_);
        side.over = &workload != &loaded_.workload;
        if (side.over) side.label.name = "own-over";
        sides_.push_back(std::move(side));
        return {};
    }

    Result<void> add_peers() {
        for (const auto& peer : loaded_.peers)
            if (auto added = add_forms(*peer); !added) return added;
        return {};
    }

    Result<void> add_forms(PeerLibrary& peer) {
        for (const PeerForm& form : peer.forms()) {
            const bool answers = std::find(form.queries.begin(), form.queries.end(), set_.query) !=
                                 form.queries.end();
            const bool wanted = contains(options_.peers, form.name);
            const bool comparable =
                std::any_of(sides_.begin(), sides_.end(),
                            [&](const Side& side) { return side.masks == form.masks; });
            if (!wanted || !answers || !comparable) continue;
            auto side =
                make_peer_side(peer, form, loaded_.workload, set_.rays, set_.query, hits_max_);
            if (!side) return tl::unexpected(side.error());
            sides_.push_back(std::move(*side));
        }
        return {};
    }

    const Options& options_;
    Loaded& loaded_;
    const RayMask& set_;
    std::uint32_t hits_max_;
    std::vector<Side> sides_;
};

/// Every variant of ours gives the bits of the first one that asks the same. v2 has no fma: its
/// bits are its own.
Result<void> check_own(const std::vector<Side>& sides) {
    std::map<std::tuple<bool, bool, bool>, const Side*> first;
    for (const Side& side : sides) {
        if (side.peer != nullptr) continue;
        const auto [at, added] =
            first.try_emplace({side.masks, side.over, side.label.target == "v2"}, &side);
        const std::uint64_t unequal = count_unequal(*side.answers, *at->second->answers);
        if (unequal == 0) continue;
        const Label& a = side.label;
        const Label& b = at->second->label;
        return fail(ErrorCode::internal, std::to_string(unequal) + " answers of " + a.intersector +
                                             "/" + a.traversal + "/" + a.target + " differ from " +
                                             b.intersector + "/" + b.traversal + "/" + b.target);
    }
    return {};
}

/// Returns the mismatches that edges and the rounding of transforms explain. Per 131,072 requested
/// hits these are 2 in one tree, 25 through one level of instances, 60 through more.
std::uint64_t mismatches_max(const Loaded& loaded, const Answers& answers) {
    const std::uint32_t levels = loaded.workload.scene->statistics().levels;
    const std::uint64_t limit = levels <= 1 ? 2 : levels == 2 ? 25 : 60;
    constexpr std::uint64_t per = 131072;
    return limit * std::max<std::uint64_t>(1, answers.hits.size() / per);
}

/// Sides that `ours` gets a row against.
std::vector<const Side*> opponents_of(const Side& ours, const std::vector<Side>& sides,
                                      const Options& options) {
    std::vector<const Side*> opponents;
    if (contains(options.peers, "own") && &ours != &sides.front()) {
        opponents.push_back(&sides.front());
    }
    for (const Side& side : sides) {
        const bool own_form = side.over && side.label.traversal == ours.label.traversal &&
                              side.label.intersector == ours.label.intersector &&
                              side.label.counters == ours.label.counters &&
                              side.label.target == ours.label.target;
        if (own_form || (side.peer != nullptr && side.masks == ours.masks)) {
            opponents.push_back(&side);
        }
    }
    return opponents;
}

std::string about(const std::vector<std::unique_ptr<PeerLibrary>>& peers) {
    std::string all;
    for (const auto& peer : peers) all += (all.empty() ? "" : "; ") + peer->about();
    return all;
}

const char* name_of(Query query) {
    return query == query_closest ? "closest" : query == query_any ? "any" : "multi";
}

}  // namespace

Result<bool> contest(const Options& options, Loaded& loaded, const std::string& rays) {
    const auto set = prepare_rays(options, loaded, rays);
    if (!set) return tl::unexpected(set.error());
    const auto ray_count = static_cast<std::uint32_t>(set->rays.size());
    std::vector<Reference> references;
    if (!options.ref.empty()) {
        auto read = read_references(options.ref);
        if (!read) return tl::unexpected(read.error());
        if (read->size() != ray_count || set->query == query_multi) {
            return fail(ErrorCode::param_invalid,
                        options.ref +
                            " does not answer these rays: it needs one record per ray, "
                            "and a query of one hit");
        }
        references = std::move(*read);
    }
    auto sides = Sides(options, loaded, *set).make();
    if (!sides) return tl::unexpected(sides.error());
    for (Side& side : *sides) answer(side, ray_count);
    if (auto checked = check_own(*sides); !checked) return tl::unexpected(checked.error());

    // Before any timing, which overwrites the answers: differences of every pair that gets a row.
    std::map<std::pair<const Side*, const Side*>, Differences> differences;
    std::map<const Side*, Differences> ref_differences;
    bool within = true;
    const AtMaskBorder at_mask_border = [&](std::size_t ray, const HitRecord& nearer) {
        return is_at_mask_border(loaded.workload.scene->view(), set->rays[ray], nearer);
    };
    for (const Side& ours : *sides) {
        if (ours.peer != nullptr || ours.over) continue;
        if (!references.empty()) ref_differences[&ours] = compare(*ours.answers, references);
        for (const Side* opponent : opponents_of(ours, *sides, options)) {
            Differences& found = differences[{&ours, opponent}];
            if (ours.masks != opponent->masks) continue;
            found = compare(*ours.answers, *opponent->answers,
                            ours.masks ? at_mask_border : AtMaskBorder{});
            within = within && found.mismatches <= mismatches_max(loaded, *ours.answers);
        }
    }

    std::vector<Entrant> entrants;
    for (const Side& side : *sides) entrants.push_back({side.trace, side.label.threads});
    const RaceLaps raced = race(entrants, ray_count, options.rounds);
    const auto laps_of = [&](const Side* side) {
        return std::span<const Lap>(raced.laps[static_cast<std::size_t>(side - sides->data())]);
    };
    const Setting setting{
        loaded.workload.name, loaded.workload.scene->digest(), rays, name_of(set->query), ray_count,
        about(loaded.peers)};
    for (const Side& ours : *sides) {
        if (ours.peer != nullptr || ours.over) continue;
        const auto opponents = opponents_of(ours, *sides, options);
        Outcome alone{ours, laps_of(&ours), raced.crowded_from};
        alone.ref_differences = ref_differences[&ours];
        if (opponents.empty()) print_row(options, setting, alone);
        for (const Side* opponent : opponents) {
            Outcome outcome = alone;
            outcome.opponent = opponent;
            outcome.opponent_laps = laps_of(opponent);
            outcome.differences = differences[{&ours, opponent}];
            outcome.mismatches_max = mismatches_max(loaded, *ours.answers);
            print_row(options, setting, outcome);
        }
    }
    return within;
}

}  // namespace raynest::bench

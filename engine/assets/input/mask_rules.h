// Rules "GLOB=HEX" that set the masks of placements by their paths.
//
// A glob is plain text in which '*' stands for any text, '/' included. A rule that matches a path
// applies to everything below it; of several rules the last one wins. Each glob is a small
// automaton, and its state after a path decides all matches below. So equal subtrees reached in
// equal states have equal masks, and the work is bounded by the letters of names, not by those of
// paths.
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

namespace raynest {

inline constexpr std::uint32_t mask_all = 0xFFFFFFFFU;
/// Bound on rules times path steps; a forest of 4 million trees can use 64 rules.
inline constexpr std::uint64_t mask_work_max = 1ULL << 28;

class MaskRules {
public:
    /// Parses 1 to 8 hex digits, optionally after 0x; nothing for any other text.
    static std::optional<std::uint32_t> parse_mask(std::string_view digits);
    /// Parses rules; scene_invalid if one is not GLOB=HEX.
    static Result<MaskRules> parse(std::span<const std::string> rules);

    [[nodiscard]] bool empty() const { return rules_.empty(); }

    /// Progress of all rules in a path; equal progress has the same number.
    using State = std::uint32_t;
    [[nodiscard]] static State start() { return 0; }
    /// Returns the state after one more path step. `first`: no '/' precedes it. limit_exceeded
    /// after mask_work_max.
    Result<State> step(State from, std::string_view name, bool first);
    /// Returns the mask for a path and everything below it; nothing if no rule matches.
    [[nodiscard]] std::optional<std::uint32_t> mask(State state) const;
    /// True if no path below can match a rule that does not match here.
    [[nodiscard]] bool is_settled(State state) const;

    /// Adds one warning for each rule without an effect.
    void warn(SceneDescription& scene) const;

private:
    /// A compiled rule. Places are offsets in the glob; fallback[i] is the place to try when a
    /// letter does not match at i.
    struct Rule {
        std::string text;
        std::string glob;
        std::uint32_t mask = mask_all;
        std::vector<std::uint32_t> fallback;
        bool matched = false;

        [[nodiscard]] std::uint32_t skip_stars(std::uint32_t place) const;
        [[nodiscard]] std::uint32_t after(std::uint32_t place, char letter) const;
    };
    struct Reached {
        std::uint32_t matched = no_id;      ///< the last rule that matched
        std::vector<std::uint32_t> places;  ///< by rule; no_id if the rule can no longer match
    };
    /// Records the last rule that matches here, and drops it and those that it overrides.
    void match(Reached& reached);
    State number_of(Reached reached);

    std::vector<Rule> rules_;
    std::vector<Reached> states_;
    std::unordered_map<std::string, State> known_;
    std::uint64_t work_ = 0;
};

/// Sets the masks of the instances of a scene without path nodes. Duplicates objects that are
/// reached in different states.
Result<void> apply_masks(MaskRules& rules, SceneDescription& scene);

}  // namespace raynest

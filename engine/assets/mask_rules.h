// Rules "GLOB=HEX" that give placements their masks by the texts of their paths.
//
// A glob is plain text in which '*' stands for any text, '/' included. What matches a path holds
// for all below it, and of several rules the last one wins. Each glob is a small automaton; its
// place after a text is all that matters for what lies below. So equal subtrees that are reached in
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
/// Rules times steps of paths that are looked at; a forest of 4 million trees takes 64 rules.
inline constexpr std::uint64_t mask_work_max = 1ULL << 28;

class MaskRules {
public:
    /// 1 to 8 hex digits, perhaps after 0x; nothing for any other text.
    static std::optional<std::uint32_t> parse_mask(std::string_view digits);
    /// scene_invalid for what is not GLOB=HEX.
    static Result<MaskRules> parse(std::span<const std::string> rules);

    [[nodiscard]] bool empty() const { return rules_.empty(); }

    /// How far all rules have come in a text; equal ones are one number.
    using State = std::uint32_t;
    [[nodiscard]] static State start() { return 0; }
    /// After one more step of a path. `first`: no '/' comes before it. limit_exceeded after
    /// mask_work_max.
    Result<State> step(State from, std::string_view name, bool first);
    /// What the rules say about a path and all below it; nothing: as it was.
    [[nodiscard]] std::optional<std::uint32_t> mask(State state) const;
    /// No rule can match anything below that does not match here.
    [[nodiscard]] bool is_settled(State state) const;

    /// One warning for each rule without an effect.
    void warn(SceneDescription& scene) const;

private:
    /// Places are offsets in a glob; `fallback` of one is where a letter that does not fit leads.
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
        std::vector<std::uint32_t> places;  ///< by rule; no_id: it does not match any more
    };
    State number_of(Reached reached);

    std::vector<Rule> rules_;
    std::vector<Reached> states_;
    std::unordered_map<std::string, State> known_;
    std::uint64_t work_ = 0;
};

/// Gives the instances of a scene without path nodes their masks. Objects that are reached in
/// different states become different objects.
Result<void> apply_masks(MaskRules& rules, SceneDescription& scene);

}  // namespace raynest

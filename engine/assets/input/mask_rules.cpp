#include "engine/assets/input/mask_rules.h"

#include "engine/assets/input/messages.h"
#include "engine/scene/snapshot.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <utility>

namespace raynest {

std::uint32_t MaskRules::Rule::skip_stars(std::uint32_t place) const {
    while (place < glob.size() && glob[place] == '*') ++place;
    return place;
}

/// Returns the place after one more letter. The match is greedy: a star never gives back a letter,
/// because an early match of the text behind it is as good as a late one.
std::uint32_t MaskRules::Rule::after(std::uint32_t place, char letter) const {
    while (place != no_id) {
        if (place < glob.size() && glob[place] == letter) return skip_stars(place + 1);
        // Right behind a star: the star takes the letter.
        if (place != 0 && glob[place - 1] == '*') return place;
        place = fallback[place];
    }
    return no_id;
}

std::optional<std::uint32_t> MaskRules::parse_mask(std::string_view digits) {
    if (digits.starts_with("0x") || digits.starts_with("0X")) digits.remove_prefix(2);
    std::uint32_t mask = 0;
    const char* const end = digits.data() + digits.size();
    const auto [stop, error] = std::from_chars(digits.data(), end, mask, 16);
    if (error != std::errc() || stop != end || digits.size() > 8) return std::nullopt;
    return mask;
}

Result<MaskRules> MaskRules::parse(std::span<const std::string> rules) {
    MaskRules all;
    Reached start;
    for (const std::string& text : rules) {
        const auto malformed =
            fail(ErrorCode::scene_invalid,
                 fmt::format("mask rule '{}' is not GLOB=HEX, for example 'stand-*/birch-*=F0'",
                             one_line(text)));
        const std::size_t equals = text.rfind('=');
        if (equals == 0 || equals == std::string::npos) return malformed;
        const auto mask = parse_mask(std::string_view(text).substr(equals + 1));
        if (!mask) return malformed;
        Rule rule{text, text.substr(0, equals), *mask, {}};

        // Knuth, Morris and Pratt, for the part behind each star.
        const auto size = static_cast<std::uint32_t>(rule.glob.size());
        rule.fallback.assign(size + 1, no_id);
        std::uint32_t part = no_id;  // first letter behind the last star
        for (std::uint32_t i = 0; i < size; ++i) {
            if (rule.glob[i] == '*') part = i + 1;
            if (part == no_id || i < part) continue;
            std::uint32_t place = rule.fallback[i];
            while (place != no_id && place != part && rule.glob[place] != rule.glob[i])
                place = rule.fallback[place];
            const bool fits = place != no_id && i > part && rule.glob[place] == rule.glob[i];
            rule.fallback[i + 1] = fits ? place + 1 : part;
        }
        start.places.push_back(rule.skip_stars(0));
        all.rules_.push_back(std::move(rule));
    }
    // A glob of stars alone matches the empty path, so it applies to the root's own primitives.
    all.match(start);
    all.number_of(std::move(start));
    return all;
}

MaskRules::State MaskRules::number_of(Reached reached) {
    std::string key(reinterpret_cast<const char*>(&reached.matched), sizeof reached.matched);
    key.append(reinterpret_cast<const char*>(reached.places.data()),
               reached.places.size() * sizeof reached.places[0]);
    const auto [entry, is_new] = known_.try_emplace(std::move(key), states_.size());
    if (is_new) states_.push_back(std::move(reached));
    return entry->second;
}

Result<MaskRules::State> MaskRules::step(State from, std::string_view name, bool first) {
    work_ += rules_.size();
    if (work_ > mask_work_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("{} mask rules are too many for the nodes and placements of this "
                                "scene: pass fewer rules, or one pattern for a group",
                                rules_.size()));
    }
    if (is_settled(from)) return from;
    Reached reached = states_[from];
    for (std::uint32_t r = 0; r < rules_.size(); ++r) {
        const Rule& rule = rules_[r];
        std::uint32_t& place = reached.places[r];
        if (place == no_id) continue;
        if (!first) place = rule.after(place, '/');
        for (const char letter : name) {
            if (place == no_id) break;
            place = rule.after(place, letter);
        }
    }
    match(reached);
    return number_of(std::move(reached));
}

void MaskRules::match(Reached& reached) {
    for (std::uint32_t r = 0; r < rules_.size(); ++r) {
        if (reached.places[r] != rules_[r].glob.size()) continue;
        rules_[r].matched = true;
        reached.matched = r;
    }
    // A later rule overrides earlier ones for everything below.
    if (reached.matched != no_id) {
        const auto overruled = static_cast<std::ptrdiff_t>(reached.matched) + 1;
        std::fill_n(reached.places.begin(), overruled, no_id);
    }
}

std::optional<std::uint32_t> MaskRules::mask(State state) const {
    const std::uint32_t rule = states_[state].matched;
    if (rule == no_id) return std::nullopt;
    return rules_[rule].mask;
}

bool MaskRules::is_settled(State state) const {
    const auto& places = states_[state].places;
    return std::all_of(places.begin(), places.end(), [](auto place) { return place == no_id; });
}

void MaskRules::warn(SceneDescription& scene) const {
    for (const Rule& rule : rules_) {
        if (rule.matched || scene.warnings.size() >= scene_warnings_max) continue;
        scene.warnings.push_back(fmt::format(
            "mask rule '{}' changes nothing: no path matches it, or later rules override it",
            one_line(rule.text)));
    }
}

}  // namespace raynest

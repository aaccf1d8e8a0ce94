// A value of a composition's text, which says its place where it is wrong.
#pragma once

#include "engine/assets/input/mask_rules.h"
#include "engine/assets/input/messages.h"
#include "engine/math/matrix.h"
#include "engine/result.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest::composition {

using Json = nlohmann::json;

/// Ends the reading; read() makes an error of it.
struct Refusal {
    Error error;
};

[[noreturn]] inline void refuse(std::string why, ErrorCode code = ErrorCode::scene_invalid) {
    throw Refusal{{code, std::move(why)}};
}

/// A value and its place in the text, "instances[3].matrix".
class Value {
public:
    Value(const Json& json, std::string place) : json_(json), place_(std::move(place)) {}

    [[nodiscard]] const std::string& place() const { return place_; }
    [[noreturn]] void refuse_it(std::string_view why) const {
        refuse(fmt::format("{} {}", place_.empty() ? "the text" : place_, why));
    }

    /// Fails where there are members beside these.
    const Value& only(std::initializer_list<std::string_view> known) const {
        return only(std::span(known.begin(), known.size()));
    }
    const Value& only(std::span<const std::string_view> known) const {
        if (!json_.is_object()) refuse_it("is no object of members in braces");
        for (const auto& [key, value] : json_.items()) {
            if (std::ranges::find(known, key) != known.end()) continue;
            std::string list;
            for (const std::string_view name : known)
                list += (list.empty() ? "" : ", ") + std::string(name);
            refuse_it(fmt::format("has a member '{}', which is none of {}", one_line(key), list));
        }
        return *this;
    }
    [[nodiscard]] bool has(const char* key) const { return json_.contains(key); }
    [[nodiscard]] Value at(const char* key) const {
        if (!has(key)) refuse_it(fmt::format("has no '{}'", key));
        return {json_.at(key), place_.empty() ? key : place_ + "." + key};
    }
    [[nodiscard]] std::string text() const {
        if (!json_.is_string()) refuse_it("is no text");
        return json_.get<std::string>();
    }
    [[nodiscard]] double number() const {
        const double value = json_.is_number() ? json_.get<double>() : double{NAN};
        if (!std::isfinite(value)) refuse_it("is no finite number");
        return value;
    }
    [[nodiscard]] bool is_list() const { return json_.is_array(); }
    [[nodiscard]] bool is_text() const { return json_.is_string(); }
    [[nodiscard]] std::uint32_t bits() const {
        std::optional<std::uint32_t> mask;
        if (json_.is_string()) mask = MaskRules::parse_mask(text());
        if (json_.is_number_unsigned() && json_.get<std::uint64_t>() <= 0xFFFFFFFFU)
            mask = json_.get<std::uint32_t>();
        if (!mask) refuse_it("is no number from 0 to 4294967295, nor a text such as \"0xF0\"");
        return *mask;
    }
    [[nodiscard]] std::vector<Value> list() const {
        if (!is_list()) refuse_it("is no list in brackets");
        std::vector<Value> items;
        for (std::size_t i = 0; i < json_.size(); ++i)
            items.emplace_back(json_[i], fmt::format("{}[{}]", place_, i));
        return items;
    }
    template <class Visit>
    void each_member(Visit&& visit) const {
        if (!json_.is_object()) refuse_it("is no object of members in braces");
        for (const auto& [key, value] : json_.items())
            visit(key, Value(value, fmt::format("{}.{}", place_, one_line(key))));
    }
    template <std::size_t N>
    [[nodiscard]] std::array<double, N> numbers() const {
        std::array<double, N> made{};
        if (!is_list() || json_.size() != N) refuse_it(fmt::format("is no list of {} numbers", N));
        for (std::size_t i = 0; i < N; ++i) made[i] = Value(json_[i], place_).number();
        return made;
    }
    [[nodiscard]] glm::dvec3 vector() const {
        const auto xyz = numbers<3>();
        return {xyz[0], xyz[1], xyz[2]};
    }

private:
    const Json& json_;
    std::string place_;
};

}  // namespace raynest::composition

// The JSON pre-scan: an event parser that keeps a path and some counts, never a tree.
//
// It uses the same JSON grammar as tinygltf does, so both read a text alike. It is iterative, so
// nesting costs no stack.
#include "engine/assets/gltf/file/prescan.h"

#include "engine/assets/gltf/file/uri.h"
#include "engine/assets/input/mask_rules.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <unordered_set>

namespace raynest::gltf {
namespace {

/// tinygltf takes about 1 kB per node, accessor or material, however short its text. Exported
/// objects average above 40 bytes; a file far below that is made to use up memory.
constexpr std::uint64_t objects_free = 65536;
constexpr std::uint64_t json_bytes_per_object = 16;

/// Members that are read only if they have this type; else the file's reader takes the default.
enum class Type : std::uint8_t { number, whole, text, list, other };
struct TypedMember {
    std::string_view list;
    std::string_view inside;  ///< an object in the element, or ""
    std::string_view member;
    Type type;
};
constexpr std::array typed_members{
    TypedMember{"materials", "", "alphaCutoff", Type::number},
    TypedMember{"materials", "", "alphaMode", Type::text},
    TypedMember{"materials", "pbrMetallicRoughness", "baseColorFactor", Type::list},
    TypedMember{"samplers", "", "magFilter", Type::number},
    TypedMember{"samplers", "", "wrapS", Type::number},
    TypedMember{"samplers", "", "wrapT", Type::number},
    TypedMember{"nodes", "", "translation", Type::list},
    TypedMember{"nodes", "", "rotation", Type::list},
    TypedMember{"nodes", "", "scale", Type::list},
    TypedMember{"nodes", "", "matrix", Type::list},
    TypedMember{"nodes", "", "mesh", Type::whole},
    TypedMember{"nodes", "", "skin", Type::whole},
    TypedMember{"nodes", "", "camera", Type::whole},
    TypedMember{"accessors", "", "bufferView", Type::whole},
    TypedMember{"accessors", "", "byteOffset", Type::whole},
    TypedMember{"bufferViews", "", "byteOffset", Type::whole},
    TypedMember{"bufferViews", "", "byteStride", Type::whole},
    TypedMember{"textures", "", "source", Type::whole},
    TypedMember{"textures", "", "sampler", Type::whole},
    TypedMember{"skins", "", "inverseBindMatrices", Type::whole},
};
constexpr std::string_view name_of(Type type) {
    switch (type) {
        case Type::number:
            return "a number";
        case Type::whole:
            return "a whole number";
        case Type::text:
            return "a text";
        default:
            return "a list of numbers";
    }
}

/// True for members whose numbers may be fractions; whole ones of others count or name something.
bool holds_fractions(std::string_view member) {
    constexpr std::array members{"translation", "rotation", "scale", "matrix",
                                 "weights",     "min",      "max"};
    return std::ranges::find(members, member) != members.end() || member.ends_with("Factor");
}

class Scan {
public:
    using number_integer_t = nlohmann::json::number_integer_t;
    using number_unsigned_t = nlohmann::json::number_unsigned_t;
    using number_float_t = nlohmann::json::number_float_t;
    using string_t = nlohmann::json::string_t;
    using binary_t = nlohmann::json::binary_t;

    Scan(std::size_t bytes, const ImportLimits& limits)
        : limits_(limits),
          objects_max_(objects_free + bytes / json_bytes_per_object) {}

    [[nodiscard]] const Error& error() const { return error_; }
    [[nodiscard]] const Prescan& found() const { return found_; }

    bool null() { return scalar("null"); }
    bool boolean(bool) { return scalar("a boolean"); }
    bool number_integer(number_integer_t) {
        note(Type::number);
        return true;
    }
    bool number_unsigned(number_unsigned_t value) {
        constexpr number_unsigned_t mask_max = 0xFFFFFFFF;
        note(Type::whole,
             value <= mask_max ? std::optional(static_cast<std::uint32_t>(value)) : std::nullopt);
        // tinygltf throws on such a buffer.
        if (value == 0 && at("buffers", "byteLength")) found_.one_binary = false;
        return true;
    }
    bool number_float(number_float_t value, const string_t&) {
        const bool is_whole = value >= 0 && value <= 0xFFFFFFFF && value == std::floor(value);
        // tinygltf drops a 36.0 where it wants an integer.
        if (is_whole && !holds_fractions(member())) found_.one_binary = false;
        if (is_whole) return number_unsigned(static_cast<number_unsigned_t>(value));
        return number_integer(0);
    }
    bool binary(binary_t&) { return true; }

    bool string(string_t& value) {
        if (!scalar("a string", Type::text, MaskRules::parse_mask(value))) return false;
        if (at("images", "uri")) found_.one_binary = false;
        if (!at("buffers", "uri")) return true;
        found_.one_binary = false;
        if (value.starts_with("data:") || file_of_uri(value)) return true;
        return refuse(ErrorCode::scene_invalid,
                      fmt::format("the scene names the file '{}'; only files beside or below the "
                                  "scene file may be used",
                                  one_line(value, 80)));
    }

    bool start_object(std::size_t) {
        if (levels_.size() == 2) ++elements_;
        if (!at_mask(3)) note(Type::other);
        if (++objects_ > objects_max_) {
            return refuse(
                ErrorCode::limit_exceeded,
                fmt::format("the scene's JSON has more than {} objects in its {} bytes",
                            objects_max_, (objects_max_ - objects_free) * json_bytes_per_object));
        }
        if (in_top_array("nodes") && elements_ > limits_.nodes_max) {
            return refuse(ErrorCode::limit_exceeded,
                          fmt::format("the scene has more than {} nodes", limits_.nodes_max));
        }
        if (in_top_array("buffers") && ++buffers_ > 1) found_.one_binary = false;
        return open({});
    }

    bool end_object() {
        levels_.pop_back();
        return true;
    }

    bool start_array(std::size_t) {
        note(Type::list);
        return open({});
    }
    bool end_array() {
        levels_.pop_back();
        return true;
    }

    bool key(string_t& name) {
        Level& level = levels_.back();
        level.key = name;
        if (levels_.size() == 1) elements_ = 0;
        if (level.keys.insert(name).second) return true;
        return refuse(
            ErrorCode::scene_invalid,
            fmt::format("the key '{}' occurs twice in one JSON object", one_line(name, 80)));
    }

    bool parse_error(std::size_t position, const std::string&, const nlohmann::json::exception&) {
        return refuse(ErrorCode::scene_invalid,
                      fmt::format("the scene's JSON is damaged at byte {}", position));
    }

private:
    struct Level {
        std::string key;  ///< the member being read; empty in arrays
        std::unordered_set<std::string> keys;
    };

    bool refuse(ErrorCode code, std::string message) {
        error_ = {code, std::move(message)};
        return false;
    }

    bool open(Level level) {
        if (levels_.size() >= limits_.json_depth_max) {
            return refuse(ErrorCode::limit_exceeded,
                          fmt::format("the scene's JSON is nested deeper than {} levels",
                                      limits_.json_depth_max));
        }
        levels_.push_back(std::move(level));
        return true;
    }

    /// The member whose value is being read, or in whose array it stands.
    [[nodiscard]] std::string_view member() const {
        const bool in_array = levels_.back().key.empty() && levels_.size() > 1;
        return in_array ? levels_[levels_.size() - 2].key : levels_.back().key;
    }
    /// True inside the elements' array of a top-level member: {"nodes": [ <here>
    [[nodiscard]] bool in_top_array(std::string_view member) const {
        return levels_.size() == 2 && levels_[0].key == member;
    }
    /// True at a value of one of those elements: {"buffers": [{"uri": <here>
    [[nodiscard]] bool at(std::string_view member, std::string_view key) const {
        return levels_.size() == 3 && levels_[0].key == member && levels_[2].key == key;
    }

    /// True at extras.raynest of a node (depth 3), or at its member `mask` (4).
    [[nodiscard]] bool at_mask(std::size_t depth) const {
        return levels_.size() == depth + 1 && levels_[0].key == "nodes" &&
               levels_[2].key == "extras" && levels_[3].key == "raynest" &&
               (depth == 3 || levels_[4].key == "mask");
    }

    /// Takes notice of a value that begins here; `mask` is what it says as a mask.
    void note(Type type, std::optional<std::uint32_t> mask = {}) {
        if (at_mask(3) || at_mask(4)) {
            const auto node = static_cast<std::uint32_t>(elements_ - 1);
            found_.masks[node] = levels_.size() == 5 ? mask : std::nullopt;
        }
        if (levels_.size() != 3 && levels_.size() != 4) return;
        for (const TypedMember& known : typed_members) {
            const bool inside = !known.inside.empty();
            if (levels_.size() != (inside ? 4 : 3) || levels_.back().key != known.member ||
                levels_[0].key != known.list || (inside && levels_[2].key != known.inside) ||
                type == known.type || (type == Type::whole && known.type == Type::number))
                continue;
            const auto same = std::find_if(
                found_.mistyped.begin(), found_.mistyped.end(), [&](const auto& other) {
                    return other.list == known.list && other.member == known.member;
                });
            if (same != found_.mistyped.end())
                ++same->more;
            else
                found_.mistyped.push_back({known.list, static_cast<std::uint32_t>(elements_ - 1),
                                           known.member, name_of(known.type), 0});
        }
    }

    /// tinygltf drops a transform that is not made of numbers and uses the identity instead.
    bool scalar(std::string_view what, Type type = Type::other,
                std::optional<std::uint32_t> mask = {}) {
        note(type, mask);
        if (levels_.size() == 4 && levels_[0].key == "nodes") {
            const std::string& member = levels_[2].key;
            for (const char* numbers : {"translation", "rotation", "scale", "matrix", "children"}) {
                if (member != numbers) continue;
                return refuse(
                    ErrorCode::scene_invalid,
                    fmt::format("the {} of a node holds {} where a number belongs", member, what));
            }
        }
        return true;
    }

    const ImportLimits& limits_;
    std::uint64_t objects_max_;
    std::vector<Level> levels_;
    std::uint64_t objects_ = 0;
    std::uint64_t elements_ = 0;  ///< begun in the top-level array that is being read
    std::uint64_t buffers_ = 0;
    Prescan found_;
    Error error_;
};

}  // namespace

Result<Prescan> prescan_json(std::span<const std::byte> json, const ImportLimits& limits) {
    if (json.size() > limits.json_bytes_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("the scene's JSON has {} MiB; at most {} are allowed",
                                json.size() >> 20, limits.json_bytes_max >> 20));
    }
    const auto* first = reinterpret_cast<const char*>(json.data());
    Scan scan(json.size(), limits);
    if (!nlohmann::json::sax_parse(first, first + json.size(), &scan)) {
        return tl::unexpected<Error>(scan.error());
    }
    return scan.found();
}

}  // namespace raynest::gltf

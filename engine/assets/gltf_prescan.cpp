// The JSON pre-scan: an event parser that keeps a path and some counts, never a tree.
//
// It is the same JSON grammar that tinygltf uses inside, so the two cannot disagree about what the
// text means; and it is iterative, so nesting costs it no stack.
#include "engine/assets/gltf_prescan.h"

#include "engine/assets/gltf_names.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <array>
#include <unordered_set>
#include <vector>

namespace raynest::gltf {
namespace {

/// tinygltf takes about 1 kB per node, accessor or material, however short its text. Exported
/// objects average above 40 bytes; a file far below that is made to cost memory.
constexpr std::uint64_t objects_free = 65536;
constexpr std::uint64_t json_bytes_per_object = 16;

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
    bool number_integer(number_integer_t) { return true; }
    bool number_unsigned(number_unsigned_t value) {
        // tinygltf throws on such a buffer.
        if (value == 0 && at("buffers", "byteLength")) found_.one_binary = false;
        return true;
    }
    bool number_float(number_float_t, const string_t&) { return true; }
    bool binary(binary_t&) { return true; }

    bool string(string_t& value) {
        if (!scalar("a string")) return false;
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
        if (++objects_ > objects_max_) {
            return refuse(
                ErrorCode::limit_exceeded,
                fmt::format("the scene's JSON has more than {} objects in its {} bytes",
                            objects_max_, (objects_max_ - objects_free) * json_bytes_per_object));
        }
        if (in_top_array("nodes") && ++nodes_ > limits_.nodes_max) {
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

    bool start_array(std::size_t) { return open({}); }
    bool end_array() {
        levels_.pop_back();
        return true;
    }

    bool key(string_t& name) {
        Level& level = levels_.back();
        level.key = name;
        if (level.keys.insert(name).second) return true;
        return refuse(
            ErrorCode::scene_invalid,
            fmt::format("the key '{}' stands twice in one JSON object", one_line(name, 80)));
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

    /// Inside the elements' array of a top-level member: {"nodes": [ <here>
    [[nodiscard]] bool in_top_array(std::string_view member) const {
        return levels_.size() == 2 && levels_[0].key == member;
    }
    /// At a value of one of those elements: {"buffers": [{"uri": <here>
    [[nodiscard]] bool at(std::string_view member, std::string_view key) const {
        return levels_.size() == 3 && levels_[0].key == member && levels_[2].key == key;
    }

    /// tinygltf drops a transform that is not made of numbers and goes on with the identity.
    bool scalar(std::string_view what) {
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
    std::uint64_t nodes_ = 0;
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

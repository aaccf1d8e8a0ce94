#include "server/options/toml_config.h"

#define TOML_HEADER_ONLY 1
#define TOML_EXCEPTIONS 0
#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <optional>
#include <sstream>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

/// Returns the text of a value; nothing if it is of another type.
std::optional<std::string> to_text(const toml::node& node) {
    if (const auto* text = node.as_string()) return text->get();
    if (const auto* number = node.as_integer()) return std::to_string(number->get());
    if (const auto* truth = node.as_boolean()) return truth->get() ? "true" : "false";
    return std::nullopt;
}

}  // namespace

tl::expected<std::vector<ConfigKey>, ConfigFault> read_toml(const std::string& content) {
    const toml::parse_result parsed = toml::parse(std::string_view(content));
    if (!parsed)
        return tl::unexpected(ConfigFault{
            parsed.error().source().begin.line,
            fmt::format(
                "{}; a file is TOML: KEY = \"VALUE\", and several values as [\"ONE\", \"TWO\"]",
                parsed.error().description())});
    std::vector<ConfigKey> keys;
    for (const auto& [key, node] : parsed.table()) {
        const std::string name(key.str());
        ConfigKey read{node.source().begin.line, name, {}, {}};
        const auto refuse = [&](const char* why) {
            return tl::unexpected(ConfigFault{read.line, "'" + name + "' " + why});
        };
        if (node.is_table()) return refuse("is a section; write KEY = VALUE without sections");
        const toml::array* list = node.as_array();
        const std::size_t count = list == nullptr ? 1 : list->size();
        for (std::size_t i = 0; i < count; ++i) {
            const toml::node* value = list == nullptr ? &node : list->get(i);
            auto text = value == nullptr ? std::nullopt : to_text(*value);
            if (!text) return refuse("is neither a string, a number nor true, nor a list of them");
            read.values.push_back(std::move(*text));
            read.lines.push_back(value->source().begin.line);
        }
        if (std::ranges::all_of(read.values, &std::string::empty))
            return refuse("has no value; leave it out");
        keys.push_back(std::move(read));
    }
    std::ranges::sort(keys, {}, &ConfigKey::line);
    return keys;
}

std::string toml_text(const std::string& text) {
    std::ostringstream written;
    written << toml::toml_formatter(toml::value<std::string>(text), toml::format_flags::none);
    return std::move(written).str();
}

}  // namespace raynest::server

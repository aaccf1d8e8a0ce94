#include "client/requests/tables.h"

#include "client/files/files.h"
#include "client/files/npy.h"
#include "protocol/limits.h"

#include <algorithm>
#include <charconv>
#include <span>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

/// Bytes of a file: of each value more digits than float32 tells apart.
constexpr std::uint64_t table_file_bytes_max = 64 * protocol::Limits{}.table_values_max;

Result<std::vector<float>> parse_array(std::span<const std::byte> bytes) {
    auto array = parse_npy(bytes);
    if (!array) return tl::unexpected<Failure>(array.error());
    if (array->shape.size() != 1)
        return fail(Exit::invalid,
                    "has " + std::to_string(array->shape.size()) + " dimensions; a table has one");
    std::vector<float> values(array->shape[0]);
    array->shape = {values.size(), 1};
    read_rows(*array, 0, values);
    return values;
}

Result<std::vector<float>> parse_text(std::string_view text) {
    constexpr std::string_view between = ", \t\r\n";
    std::vector<float> values;
    for (;;) {
        text.remove_prefix(std::min(text.find_first_not_of(between), text.size()));
        if (text.empty()) return values;
        const std::string_view word = text.substr(0, text.find_first_of(between));
        float value = 0;
        const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
        if (error != std::errc{} || end != word.data() + word.size())
            return fail(Exit::invalid, "holds '" + std::string(word.substr(0, 40)) +
                                           "', which is no number of float32");
        values.push_back(value);
        text.remove_prefix(word.size());
    }
}

Result<std::vector<float>> read_table(const std::string& path) {
    const auto file = read_file(path, table_file_bytes_max);
    if (!file) return tl::unexpected<Failure>(file.error());
    const std::span<const std::byte> bytes = file->span();
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    auto values = text.starts_with("\x93NUMPY") ? parse_array(bytes) : parse_text(text);
    if (!values) return fail(Exit::invalid, shown_name(path) + " " + values.error().message);
    return values;
}

}  // namespace

Result<void> read_tables(std::vector<std::string>& settings, std::vector<TableOption>& tables) {
    for (const std::string& setting : settings) {
        const std::size_t at = setting.find("=@");
        if (at == std::string::npos || at != setting.find('=')) continue;
        auto values = read_table(setting.substr(at + 2));
        if (!values) return tl::unexpected<Failure>(values.error());
        tables.push_back({setting.substr(0, at), std::move(*values)});
    }
    std::erase_if(settings, [](const std::string& setting) {
        const std::size_t at = setting.find('=');
        return at != std::string::npos && setting.substr(at).starts_with("=@");
    });
    return {};
}

}  // namespace raynest::client

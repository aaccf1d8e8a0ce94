#include "client/output/query_rows.h"

#include "client/ground/lists.h"
#include "client/ground/text.h"
#include "client/output/output.h"
#include "client/requests/generator.h"

#include <algorithm>
#include <cstring>
#include <iostream>
#include <utility>

namespace raynest::client {
namespace {

using protocol::BlockView;

constexpr std::size_t ray_width = 10;

template <class T>
T value_at(const BlockView& block, std::uint64_t index) {
    T value;
    std::memcpy(&value, block.bytes.data() + index * sizeof(T), sizeof(T));
    return value;
}

/// Returns a value of an element as text, the same for tables and JSON.
std::string value_text(const BlockView& block, std::uint64_t element, std::uint32_t part,
                       const WorldPoint& origin) {
    const std::uint64_t index = element * block.width() + part;
    switch (block.dtype) {
        case wire::Dtype::u8:
            return std::to_string(value_at<std::uint8_t>(block, index));
        case wire::Dtype::u32:
            return std::to_string(value_at<std::uint32_t>(block, index));
        case wire::Dtype::u64:
            if (is_time(block)) return double_text(value_at<double>(block, index));
            return std::to_string(value_at<std::uint64_t>(block, index));
        case wire::Dtype::f32:
            return world_text(value_at<float>(block, index),
                              is_point_field(block.name) && part < 3 ? origin[part] : 0);
    }
    return "null";
}

/// Returns the titles of a column: uv has two; other wide columns are one key with a list.
std::vector<std::string> titles_of(const BlockView& block) {
    if (block.name == "uv" && block.width() == 2) return {"u", "v"};
    if (block.width() == 1) return {std::string(block.name)};
    std::vector<std::string> titles;
    for (std::uint32_t i = 0; i < block.width(); ++i)
        titles.push_back(std::string(block.name) + "." + std::to_string(i));
    return titles;
}

std::string json_member(const BlockView& block, std::uint64_t element, const WorldPoint& origin) {
    if (is_truth_field(block.name) && block.dtype == wire::Dtype::u8)
        return '"' + std::string(block.name) +
               (value_at<std::uint8_t>(block, element) != 0 ? "\":true" : "\":false");
    const std::vector<std::string> titles = titles_of(block);
    std::string text;
    if (titles.size() == 1 || block.name == "uv") {
        for (std::uint32_t i = 0; i < titles.size(); ++i)
            text +=
                (i == 0 ? "\"" : ",\"") + titles[i] + "\":" + value_text(block, element, i, origin);
        return text;
    }
    for (std::uint32_t i = 0; i < block.width(); ++i)
        text += (i == 0 ? "" : ",") + value_text(block, element, i, origin);
    return "\"" + std::string(block.name) + "\":[" + text + "]";
}

std::size_t width_of(wire::Dtype dtype) {
    switch (dtype) {
        case wire::Dtype::u8:
            return 5;
        case wire::Dtype::u32:
            return 10;
        case wire::Dtype::u64:
            return 20;
        case wire::Dtype::f32:
            return 14;
    }
    return 10;
}

std::string set_right(const std::string& text, std::size_t width) {
    return std::string(width > text.size() ? width - text.size() : 0, ' ') + text;
}

}  // namespace

struct QueryRows::Column {
    const BlockView* block;
    bool of_hits;
};

QueryRows::QueryRows(std::string kind, std::vector<std::string> fields, bool json)
    : kind_(std::move(kind)),
      fields_(std::move(fields)),
      json_(json) {}

std::vector<QueryRows::Column> QueryRows::columns_of(const QueryChunk& chunk) const {
    std::vector<Column> columns;
    for (const std::string& field : fields_)
        if (const BlockView* block = protocol::find_block(chunk.columns, field))
            columns.push_back({block, is_hit_field(field)});
    return columns;
}

Result<void> QueryRows::print(const QueryChunk& chunk) {
    const BlockView* hit = protocol::find_block(chunk.columns, "hit");
    if (!has_splits(kind_) && (hit == nullptr || hit->dtype != wire::Dtype::u8))
        return fail(Exit::usage,
                    "the answer has no column 'hit', by which rows tell misses; write its columns "
                    "with -o FILE.npz");
    const std::vector<Column> columns = columns_of(chunk);
    if (!json_) print_titles(columns);
    for (std::uint32_t ray = 0; ray < chunk.count; ++ray) {
        if (json_)
            print_json_ray(chunk, columns, ray);
        else
            print_table_ray(chunk, columns, ray);
    }
    return check_stdout();
}

namespace {

/// Returns the hits [first, last) of a ray: none for a closest query's miss.
std::pair<std::uint64_t, std::uint64_t> hits_of(const QueryChunk& chunk, std::uint32_t ray) {
    const BlockView* hit = protocol::find_block(chunk.columns, "hit");
    const bool miss =
        hit != nullptr && hit->count == chunk.count && value_at<std::uint8_t>(*hit, ray) == 0;
    return {chunk.splits[ray], miss ? chunk.splits[ray] : chunk.splits[ray + 1]};
}

/// True if the column `flags`, which may be hidden, says so.
bool is_invalid(const QueryChunk& chunk, std::uint32_t ray) {
    constexpr std::uint8_t flag_invalid = 1;
    const BlockView* flags = protocol::find_block(chunk.columns, "flags");
    return flags != nullptr && flags->dtype == wire::Dtype::u8 && flags->count == chunk.count &&
           (value_at<std::uint8_t>(*flags, ray) & flag_invalid) != 0;
}

}  // namespace

void QueryRows::print_json_ray(const QueryChunk& chunk, const std::vector<Column>& columns,
                               std::uint32_t ray) const {
    std::string line = "{\"ray\":" + std::to_string(chunk.first_ray + ray);
    if (is_invalid(chunk, ray)) line += ",\"invalid\":true";
    const auto [first, last] = hits_of(chunk, ray);
    if (kind_ == "any") {
        line += std::string(",\"hit\":") + (first != last ? "true" : "false");
    } else {
        line += ",\"hits\":[";
        for (std::uint64_t hit = first; hit < last; ++hit) {
            std::string members;
            for (const Column& column : columns)
                if (column.of_hits)
                    members += (members.empty() ? "" : ",") +
                               json_member(*column.block, hit, chunk.origin);
            line += (hit == first ? "{" : ",{") + members + "}";
        }
        line += "]";
    }
    for (const Column& column : columns)
        if (!column.of_hits && !(kind_ == "any" && column.block->name == "hit"))
            line += "," + json_member(*column.block, ray, chunk.origin);
    std::cout << line << "}\n";
}

void QueryRows::print_titles(const std::vector<Column>& columns) {
    if (std::exchange(titled_, true)) return;
    std::string line = set_right("ray", ray_width);
    for (const Column& column : columns)
        for (const std::string& title : titles_of(*column.block))
            line += "  " + set_right(title, width_of(column.block->dtype));
    std::cout << line << '\n';
}

void QueryRows::print_table_ray(const QueryChunk& chunk, const std::vector<Column>& columns,
                                std::uint32_t ray) const {
    // Print a ray without hits as one row with dashes in hit columns.
    const auto [first, last] = hits_of(chunk, ray);
    for (std::uint64_t hit = first; hit < std::max(last, first + 1); ++hit) {
        std::string line = set_right(std::to_string(chunk.first_ray + ray), ray_width);
        for (const Column& column : columns) {
            const BlockView& block = *column.block;
            for (std::uint32_t part = 0; part < block.width(); ++part) {
                const bool blank = column.of_hits && first == last;
                const std::uint64_t element = column.of_hits ? hit : ray;
                line +=
                    "  " + set_right(blank ? "-" : value_text(block, element, part, chunk.origin),
                                     width_of(block.dtype));
            }
        }
        std::cout << line << '\n';
    }
}

ReducedRows::ReducedRows(std::string number, bool json) : number_(std::move(number)), json_(json) {}

Result<void> ReducedRows::print(const QueryChunk& chunk) {
    constexpr std::size_t number_width = 10;
    const auto fits = [&](const BlockView& block) { return block.count == chunk.count; };
    if (chunk.columns.empty() || !std::ranges::all_of(chunk.columns, fits))
        return daemon_sent("rows without their columns");
    if (!titled_ && !json_) {
        std::string line = number_.empty() ? "" : set_right(number_, number_width) + "  ";
        for (const BlockView& block : chunk.columns)
            line += set_right(std::string(block.name), width_of(block.dtype)) + "  ";
        std::cout << line.substr(0, line.size() - 2) << '\n';
        titled_ = true;
    }
    for (std::uint32_t row = 0; row < chunk.count; ++row) {
        const std::string number = std::to_string(chunk.first_ray + row);
        std::string line;
        if (!number_.empty())
            line = json_ ? "\"" + number_ + "\":" + number + ","
                         : set_right(number, number_width) + "  ";
        for (const BlockView& block : chunk.columns)
            line += json_ ? json_member(block, row, {}) + ","
                          : set_right(value_text(block, row, 0, {}), width_of(block.dtype)) + "  ";
        line.resize(line.size() - (json_ ? 1 : 2));
        std::cout << (json_ ? "{" + line + "}" : line) << '\n';
    }
    return check_stdout();
}

}  // namespace raynest::client

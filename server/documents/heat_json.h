// The document of a heat map, encode `json`: the statistics of every metric, a histogram, and the
// encoded file where one is asked for.
#pragma once

#include "engine/integrators/picture.h"
#include "server/documents/selection_text.h"
#include "server/execution/plan.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

struct HeatDocument {
    const Plan& plan;
    const Plan* other = nullptr;  ///< whose counts are subtracted
    const HeatOptions& options;
    std::string camera;
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    const HeatStatistics& statistics;  ///< statistics of options.metric
    std::vector<std::uint64_t> histogram;
    struct Row {
        std::string metric;
        HeatStatistics statistics;
    };
    std::vector<Row> rows;  ///< every metric, in total and of each level
    struct File {
        std::string_view encode;
        std::uint32_t width = 0;
        std::uint32_t height = 0;
        std::span<const std::byte> bytes;
    } file = {};  ///< without `encode`: none
    const SelectionText& selected;
    const protocol::Limits& limits;
};

[[nodiscard]] std::string heat_json(const HeatDocument& document);
/// Returns the most bytes of such a text with so many metrics and a file of so many bytes.
[[nodiscard]] std::uint64_t heat_json_bytes_max(std::size_t metrics, std::uint64_t file_bytes);

}  // namespace raynest::server

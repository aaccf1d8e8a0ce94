// THE table of limits that bytes from outside are checked against.
//
// One struct of numbers, each with a name and a line of text: `raynestd --print-config` prints it,
// error messages quote the names, and an operator sets those that are policy: quotas and times.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

namespace raynest::protocol {

inline constexpr std::uint16_t version_min = 1;
inline constexpr std::uint16_t version_max = 1;

struct Limits {
    std::uint64_t frame_bytes_max = 64ULL << 20;
    std::uint64_t control_bytes_max = 64ULL << 10;
    std::uint64_t control_depth_max = 16;
    std::uint64_t control_tables_max = 256;
    std::uint64_t blocks_max = 64;
    std::uint64_t greeting_bytes_max = 4ULL << 10;
    std::uint64_t greeting_ms_max = 2000;
    std::uint64_t chunk_rays_max = 16ULL << 10;
    std::uint64_t window_bytes = 8ULL << 20;
    std::uint64_t window_bytes_max = 32ULL << 20;
    std::uint64_t jobs_max = 8;
    std::uint64_t rays_max = 1ULL << 36;
    std::uint64_t hits_max = 256;
    std::uint64_t all_hits_max = 65536;
    std::uint64_t azimuths_max = 65536;
    std::uint64_t name_bytes_max = 256;
    std::uint64_t text_bytes_max = 4096;
    std::uint64_t list_items_max = 512;
    std::uint64_t upload_files_max = 512;
    std::uint64_t upload_bytes_max = 4ULL << 30;
    std::uint64_t picture_side_max = 16384;
    std::uint64_t picture_pixels_max = 64ULL << 20;
    std::uint64_t samples_max = 65536;
    std::uint64_t principal_jobs_max = 128;
    std::uint64_t principal_rays_max = 1ULL << 40;
    std::uint64_t principal_scenes_max = 256;
    std::uint64_t principal_scene_bytes_max = 256ULL << 30;
    std::uint64_t principal_results_max = 1024;
    std::uint64_t principal_result_bytes_max = 1ULL << 30;
    std::uint64_t result_ms_max = 3'600'000;
    std::uint64_t connections_max = 2048;
    std::uint64_t principal_connections_max = 1536;
    std::uint64_t waiting_control_bytes_max = 256ULL << 10;
    std::uint64_t total_jobs_max = 256;
    std::uint64_t give_way_ms = 5000;
    std::uint64_t drain_ms_max = 30000;
    std::uint64_t chunk_ms_max = 60000;
    std::uint64_t cuda_rays_max = 128ULL << 10;
    std::uint64_t cuda_call_ms_max = 5000;
    std::uint64_t cuda_start_ms_max = 60000;
    std::uint64_t cuda_retry_ms = 1000;
    std::uint64_t cuda_retry_ms_max = 300'000;
};

struct LimitInfo {
    std::string_view name;
    std::uint64_t Limits::*value;
    std::string_view text;
    bool policy = false;  ///< an option of raynestd; else both ends rely on it
};

/// Every member of Limits, in order.
[[nodiscard]] std::span<const LimitInfo> limit_table();

}  // namespace raynest::protocol

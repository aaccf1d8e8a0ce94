#include "protocol/limits.h"

#include <array>

namespace raynest::protocol {
namespace {

constexpr std::array table = {
    LimitInfo{"frame_bytes_max", &Limits::frame_bytes_max, "one frame, header included"},
    LimitInfo{"control_bytes_max", &Limits::control_bytes_max, "control message of a frame"},
    LimitInfo{"control_depth_max", &Limits::control_depth_max, "nesting of tables in a message"},
    LimitInfo{"control_tables_max", &Limits::control_tables_max, "tables in a message"},
    LimitInfo{"blocks_max", &Limits::blocks_max, "blocks of a frame"},
    LimitInfo{"greeting_bytes_max", &Limits::greeting_bytes_max, "the frame before a welcome"},
    LimitInfo{"greeting_ms_max", &Limits::greeting_ms_max, "time for the greeting"},
    LimitInfo{"chunk_rays_max", &Limits::chunk_rays_max, "rays of one frame"},
    LimitInfo{"window_bytes", &Limits::window_bytes, "credit of a request at its start"},
    LimitInfo{"window_bytes_max", &Limits::window_bytes_max, "credit of a request at any time"},
    LimitInfo{"jobs_max", &Limits::jobs_max, "requests in flight of one connection"},
    LimitInfo{"rays_max", &Limits::rays_max, "rays of one query"},
    LimitInfo{"hits_max", &Limits::hits_max, "hits per ray of a multi query"},
    LimitInfo{"all_hits_max", &Limits::all_hits_max, "hits per ray of a query of kind all"},
    LimitInfo{"azimuths_max", &Limits::azimuths_max, "azimuths of a lidar"},
    LimitInfo{"name_bytes_max", &Limits::name_bytes_max, "a name or word"},
    LimitInfo{"text_bytes_max", &Limits::text_bytes_max, "a message or source"},
    LimitInfo{"list_items_max", &Limits::list_items_max, "items of a list in a message"},
    LimitInfo{"upload_files_max", &Limits::upload_files_max, "files of one upload"},
    LimitInfo{"upload_bytes_max", &Limits::upload_bytes_max, "bytes of one upload"},
    LimitInfo{"picture_side_max", &Limits::picture_side_max, "width or height of a picture"},
    LimitInfo{"picture_pixels_max", &Limits::picture_pixels_max, "pixels of a picture"},
    LimitInfo{"samples_max", &Limits::samples_max, "samples per pixel or point"},
    LimitInfo{"principal_jobs_max", &Limits::principal_jobs_max,
              "requests in flight of one principal", true},
    LimitInfo{"principal_rays_max", &Limits::principal_rays_max,
              "rays of the requests in flight of one principal", true},
    LimitInfo{"principal_scenes_max", &Limits::principal_scenes_max,
              "scenes that one principal holds", true},
    LimitInfo{"principal_scene_bytes_max", &Limits::principal_scene_bytes_max,
              "bytes of the scenes that one principal holds", true},
    LimitInfo{"principal_results_max", &Limits::principal_results_max,
              "detached jobs kept of one principal", true},
    LimitInfo{"principal_result_bytes_max", &Limits::principal_result_bytes_max,
              "bytes kept for the detached jobs of one principal", true},
    LimitInfo{"result_ms_max", &Limits::result_ms_max,
              "time that the answer of a detached job is kept", true},
    LimitInfo{"connections_max", &Limits::connections_max, "connections at a time", true},
    LimitInfo{"principal_connections_max", &Limits::principal_connections_max,
              "connections of one principal", true},
    LimitInfo{"waiting_control_bytes_max", &Limits::waiting_control_bytes_max,
              "answers without bulk that wait for their reader", true},
    LimitInfo{"total_jobs_max", &Limits::total_jobs_max, "requests in flight of all connections",
              true},
    LimitInfo{"give_way_ms", &Limits::give_way_ms,
              "time without a whole frame after which a connection gives way to a newcomer", true},
    LimitInfo{"drain_ms_max", &Limits::drain_ms_max, "time for what runs when the daemon ends",
              true},
    LimitInfo{"chunk_ms_max", &Limits::chunk_ms_max, "time for a chunk of rays on a CPU", true},
    LimitInfo{"cuda_rays_max", &Limits::cuda_rays_max,
              "rays that a GPU takes at a time, from chunk_rays_max to 131072", true},
    LimitInfo{"cuda_call_ms_max", &Limits::cuda_call_ms_max, "time for a chunk of rays on a GPU",
              true},
    LimitInfo{"cuda_start_ms_max", &Limits::cuda_start_ms_max,
              "time for a GPU to start, or to take a scene", true},
    LimitInfo{"cuda_retry_ms", &Limits::cuda_retry_ms,
              "time that a GPU is left alone after a fault, twice as long after each that follows",
              true},
    LimitInfo{"cuda_retry_ms_max", &Limits::cuda_retry_ms_max,
              "but no longer; a GPU that was up for so long starts anew with cuda_retry_ms", true},
};
static_assert(sizeof(Limits) == table.size() * sizeof(std::uint64_t),
              "a limit is missing from the table");

}  // namespace

std::span<const LimitInfo> limit_table() {
    return table;
}

}  // namespace raynest::protocol

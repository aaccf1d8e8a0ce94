// The common part of a request, whichever host makes its parts, when and by which kernel.
#pragma once

#include "protocol/wire.h"

namespace raynest::protocol {

/// Leaves out what changes no byte of an answer, and the scene, whose digest and epoch a part says itself.
inline void leave_common(wire::JobT& job) {
    job.scene.clear();
    job.epoch = 0;
    job.traversal.clear();
    job.worker.clear();
    job.priority.clear();
    job.deadline_ms = 0;
    job.detach = false;
}

/// Returns the bytes of a request without what its parts differ in.
template <class Request>
[[nodiscard]] flatbuffers::DetachedBuffer common_bytes(Request request) {
    if constexpr (requires { request.tile_x; })
        request.tile_x = request.tile_y = request.tile_width = request.tile_height = 0;
    if constexpr (requires { request.part_first; })
        request.ray_count = request.part_first = request.part_count = 0;
    if constexpr (requires { request.best_by_ms; }) request.best_by_ms = 0;
    if (request.job != nullptr) leave_common(*request.job);
    if constexpr (requires { request.other; })
        if (request.other != nullptr) leave_common(*request.other);
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(Request::TableType::Pack(builder, &request));
    return builder.Release();
}

}  // namespace raynest::protocol

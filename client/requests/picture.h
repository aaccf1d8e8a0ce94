// Shared by render and heatmap: the request for a picture, its answer, and its summary.
#pragma once

#include "client/ground/json.h"
#include "client/ground/progress.h"
#include "client/net/connection.h"
#include "client/requests/job.h"
#include "client/requests/request_options.h"
#include "client/requests/scene_origin.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::client {

/// Returns the encoding: "raw" for a .npy, which the client writes; else the ending, which the
/// daemon encodes; png for stdout as "-".
[[nodiscard]] std::string encoding_of(const std::string& output);

/// Makes a wire::RenderT or wire::HeatmapT with the fields that both have. Fails as part_of().
template <class Request>
[[nodiscard]] Result<Request> picture_request(const PictureOptions& options) {
    Request request;
    request.job = job_message(options.job);
    request.width = options.camera.width;
    request.height = options.camera.height;
    request.encode = encoding_of(options.output);
    if (options.part.count != 0) {
        const auto rows = part_of(options.part, request.height, part_rows, "rows of pixels");
        if (!rows) return tl::unexpected<Failure>(rows.error());
        request.tile_y = static_cast<std::uint32_t>(rows->first);
        request.tile_width = request.width;
        request.tile_height = static_cast<std::uint32_t>(rows->count);
    }
    return request;
}

/// The bounds of an answer, so that no daemon fills the memory or delivers something else.
struct Room {
    std::uint64_t bytes_max = 0;          ///< for a document or a file
    std::uint64_t pixel_bytes = 0;        ///< for a picture: what each pixel may have beside them
    std::uint32_t width = 0, height = 0;  ///< the picture's; 0: its first piece says them
    std::string encode = {};              ///< empty: its first piece says it
    bool starts = true;                   ///< STARTED comes first
};
/// The room of a document, of which not all have a job that starts.
[[nodiscard]] Room document_room();
/// The room of a .glb, whose format ends there, or of a composition.
[[nodiscard]] Room file_room();
/// The room of the pictures of a job that is fetched.
[[nodiscard]] Room picture_room(bool is_heat_map);
[[nodiscard]] Room room_of(const wire::RenderT& request);
[[nodiscard]] Room room_of(const wire::HeatmapT& request);
[[nodiscard]] inline Room room_of(const wire::BlameT& /*request*/) {
    return document_room();
}

/// The file that an answer brings: a picture, but of some requests a document or a .glb.
struct ReceivedFile {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::string encode;  ///< png | exr | raw; that of a document begins with json
    std::vector<std::byte> bytes;
    std::uint64_t total = 0;  ///< bytes of the whole payload; 0: none has begun
    bool is_last = false;     ///< no payload comes after this one
    float exposure = 0;       ///< for encode linear: the stops of exposure `auto`
    Outcome outcome;
};
/// Takes each whole picture of an answer that refines one, but for the last.
using PassConsumer = std::function<Result<void>(const ReceivedFile&)>;
/// Reads the answer of a running request to its end, or until it is detached. `picture` holds what is
/// known already. A later payload replaces an earlier one. Fails unless the last one is whole.
Result<ReceivedFile> receive_file(Connection& connection, Progress& progress, const Room& room,
                                  ReceivedFile picture = {}, const PassConsumer& consume_pass = {});
/// Takes the bytes of a payload in their order.
using BytesConsumer = std::function<Result<void>(std::span<const std::byte>)>;
/// Reads the answer of a running request whose payload may be larger than the memory. Returns the
/// payload's size. Fails unless it is whole.
Result<std::uint64_t> receive_bytes(Connection& connection, Progress& progress, Outcome& outcome,
                                    const BytesConsumer& consume);

/// Places the camera of a request, which `run` then asks for, in the scene's world.
template <class Request, class Run>
Result<ReceivedFile> with_camera(Connection& connection, Progress& progress,
                                 const PictureOptions& options, Request& request, Run&& run) {
    SceneOrigin origin;
    if (!options.camera.look_at.empty()) {
        const auto asked = ask_origin(connection, options.job.scene);
        if (!asked) return tl::unexpected<Failure>(asked.error());
        origin = *asked;
    }
    request.camera = camera_message(options.camera, origin.point);
    auto picture = run();
    progress.clear();
    if (picture && picture->outcome.detached == 0 && !options.camera.look_at.empty()) {
        if (auto same = check_origin(origin.point, picture->outcome.origin); !same)
            return tl::unexpected<Failure>(same.error());
    }
    return picture;
}

template <class Request>
Result<ReceivedFile> ask_picture(Connection& connection, Progress& progress,
                                 const PictureOptions& options, Request request) {
    return with_camera(connection, progress, options, request, [&]() -> Result<ReceivedFile> {
        if (auto started = connection.start(request, deadline_of(options.job.deadline)); !started)
            return tl::unexpected<Failure>(started.error());
        ReceivedFile picture;
        picture.outcome.may_detach = request.job->detach;
        return receive_file(connection, progress, room_of(request), std::move(picture));
    });
}

/// Returns a raw picture, of four bytes per pixel, as a .npy.
[[nodiscard]] Result<std::vector<std::byte>> npy_file(const ReceivedFile& picture,
                                                      const char* dtype,
                                                      std::vector<std::uint64_t> shape);

/// The document of an answer; exit code 1 where it is none.
[[nodiscard]] Result<Json> read_json(const ReceivedFile& answer);

}  // namespace raynest::client

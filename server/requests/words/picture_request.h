// Shared by the requests for pictures: the camera, the size, the encoding, the memory.
#pragma once

#include "engine/integrators/camera.h"
#include "engine/scene/digest.h"
#include "protocol/parts.h"
#include "protocol/wire.h"
#include "server/jobs/picture_job.h"
#include "server/jobs/services.h"

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server {

/// Returns advice for the user on how to make a picture smaller.
[[nodiscard]] std::string smaller_picture(std::string_view encode);

/// Checks the word of a file's encoding: png, exr or raw.
Reply<std::string> check_encode(std::string_view word);

/// The pixels that a request asks for: all of a picture, or a tile of it.
struct AskedPixels {
    ImageSize whole;
    PixelWindow window = {};
    std::string request = {};  ///< for a tile: request_digest()
    [[nodiscard]] ImageSize size() const { return window.is_whole() ? whole : window.size; }
};
/// Returns what tells requests apart: tiles of one picture have the same, on all hosts.
template <class Message>
[[nodiscard]] std::string request_digest(const Message& message) {
    const std::unique_ptr<typename Message::NativeTableType> request(message.UnPack());
    const auto bytes = protocol::common_bytes(std::move(*request));
    Sha256 digest{};
    (void)hash_bytes(std::as_bytes(std::span(bytes.data(), bytes.size())), digest);
    return digest_text(digest);
}

/// Reads the size and the tile of a Render or Heatmap.
template <class Message>
[[nodiscard]] AskedPixels asked_pixels(const Message& message) {
    AskedPixels asked{
        {message.width(), message.height()},
        {message.tile_x(), message.tile_y(), {message.tile_width(), message.tile_height()}}};
    if (!asked.window.is_whole()) asked.request = request_digest(message);
    return asked;
}

/// Makes a picture request and reserves `bytes`, the memory of the job. Chooses a camera of the
/// scene; adds a note if the scene has none.
Reply<PictureRequest> make_request(const Services& services, const Caller& caller, Plan plan,
                                   const CameraRequest& camera, const AskedPixels& pixels,
                                   std::string_view encode, std::uint64_t bytes);

/// The same for a JSON document about a camera's rays. `advice` tells how to make it smaller.
Reply<PictureRequest> make_document_request(const Services& services, const Caller& caller,
                                            Plan plan, const CameraRequest& camera,
                                            const AskedPixels& pixels, std::uint64_t bytes,
                                            std::string_view advice);

}  // namespace raynest::server

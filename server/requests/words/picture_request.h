// Shared by the requests for pictures: the camera, the size, the encoding, the memory.
#pragma once

#include "protocol/wire.h"
#include "server/jobs/picture_job.h"
#include "server/jobs/services.h"

#include <cstdint>
#include <string>
#include <string_view>

namespace raynest::server {

/// Returns advice for the user on how to make a picture smaller.
[[nodiscard]] std::string smaller_picture(std::string_view encode);

/// Checks the word of a file's encoding: png, exr or raw.
Reply<std::string> check_encode(std::string_view word);

/// The pixels that a request asks for: all of a picture, or a tile of it.
struct AskedPixels {
    ImageSize whole;
    PixelWindow window = {};
    [[nodiscard]] ImageSize size() const { return window.is_whole() ? whole : window.size; }
};
/// Reads the size and the tile of a Render or Heatmap.
template <class Message>
[[nodiscard]] AskedPixels asked_pixels(const Message& message) {
    return {{message.width(), message.height()},
            {message.tile_x(), message.tile_y(), {message.tile_width(), message.tile_height()}}};
}

/// Makes a picture request and reserves `bytes`, the memory of the job. Chooses a camera of the
/// scene; adds a note if the scene has none.
Reply<PictureRequest> make_request(const Services& services, const Caller& caller, Plan plan,
                                   const wire::Camera* camera, const AskedPixels& pixels,
                                   std::string_view encode, std::uint64_t bytes);

/// The same for a JSON document about a camera's rays. `advice` tells how to make it smaller.
Reply<PictureRequest> make_document_request(const Services& services, const Caller& caller,
                                            Plan plan, const wire::Camera* camera,
                                            const AskedPixels& pixels, std::uint64_t bytes,
                                            std::string_view advice);

}  // namespace raynest::server

#include "server/jobs/films/film_options.h"

#include "engine/integrators/film.h"
#include "server/jobs/films/received_picture.h"

#include <algorithm>
#include <thread>

namespace raynest::server {
namespace {

/// Bounds for the arrays of the threads that make samples.
constexpr std::uint64_t wavefront_bytes = 8ULL << 20;

}  // namespace

std::uint64_t film_job_bytes(ImageSize size, std::string_view encode, const FilmOptions& options) {
    const std::uint64_t film = Film::bytes(size);
    // An encoded file is at most as large as its input, and exists up to three times while it
    // grows or is copied.
    const std::uint64_t file = encode == "exr"      ? 3 * film
                               : encode == "png"    ? 5 * 4 * size.pixels()
                               : encode == "linear" ? 2 * sizeof(Vec4) * size.pixels()
                                                    : 2 * 4 * size.pixels();
    // A file to continue and the decoder's answer, with first its copy of the file, then the
    // planes.
    const std::uint64_t resumed = options.resume_bytes;
    const std::uint64_t read = resumed == 0 ? 0 : resumed + film + std::max(resumed, film);
    // The file and the decoder's copy; its answer, the picture and the tables of the light.
    const std::uint64_t surroundings =
        options.environment_bytes == 0
            ? 0
            : 2 * options.environment_bytes + 3 * environment_room(options.environment_bytes);
    const std::uint64_t threads = std::max(1U, std::thread::hardware_concurrency());
    return image_header_bytes_max + film + std::max(file, read) + surroundings +
           wavefront_bytes * (threads + 1);
}

}  // namespace raynest::server

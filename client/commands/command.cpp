#include "client/commands/command.h"

#include "client/requests/scene_source.h"

#include <algorithm>
#include <filesystem>
#include <system_error>

namespace raynest::client {

bool is_file(const std::string& path) {
    std::error_code ignored;
    return std::filesystem::is_regular_file(path, ignored);
}

bool is_lasting(const std::string& source) {
    return !is_source(source) || source.find(':') != std::string::npos || is_file(source);
}

bool is_job_safe(const JobOptions& job, const Failure& why) {
    // A detached job that was accepted runs on; only a refusal tells that none did.
    return is_lasting(job.scene) && (!job.detach || !is_own(why));
}

Parts picture_parts(const PictureOptions& picture, std::uint64_t samples) {
    const CameraOptions& camera = picture.camera;
    const std::uint64_t rays = samples * camera.width * camera.height;
    return {std::min<std::uint64_t>((camera.height + part_rows - 1) / part_rows,
                                    std::max<std::uint64_t>(1, rays / part_rays)),
            picture.output, picture.part.count != 0};
}

bool may_repeat(const Command& command, bool acts, const Failure& why, bool printed) {
    return why.lost && !acts && (!printed || command.prints_looks()) && command.is_safe(why);
}

}  // namespace raynest::client

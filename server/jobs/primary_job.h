// A picture of what each pixel's ray meets first, without light.
#pragma once

#include "server/jobs/picture_job.h"

#include <cstdint>
#include <memory>
#include <string_view>

namespace raynest::server {

/// Bytes of memory that the job of such a picture takes.
[[nodiscard]] std::uint64_t primary_job_bytes(std::uint64_t pixels, std::string_view encode);
/// Returns the maximum bytes of the payload.
[[nodiscard]] std::uint64_t primary_payload_bytes_max(std::uint32_t width, std::uint32_t height,
                                                      std::string_view encode);

[[nodiscard]] std::unique_ptr<Job> primary_job(const Services& services, const Caller& caller,
                                               PictureRequest asked);

}  // namespace raynest::server

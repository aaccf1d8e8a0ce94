// The base of jobs that explain a ray or a path: one task traces, and the answer is one JSON
// document.
#pragma once

#include "server/jobs/chunked_job.h"
#include "server/requests/request.h"
#include "server/jobs/payload_sender.h"

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace raynest::server {

/// Bytes of an entry of a document, at most: in memory and as text, with names and a path.
inline constexpr std::uint64_t explained_entry_bytes = 3 * 1024;
/// Bytes of a document but for its entries, at most.
inline constexpr std::uint64_t explained_head_bytes = 64 * 1024;

class ExplainJob : public ChunkedJob {
public:
    /// `camera`: name of the camera whose pixel is explained; empty: none.
    ExplainJob(const Services& services, const Caller& caller, Plan plan, std::string camera,
               Budget::Lease lease);

    Frames greeting() override;
    std::optional<Task> next() override;
    Reply<void> ended() override;
    [[nodiscard]] bool finished() const override { return explained_ && payload_.finished(); }
    [[nodiscard]] std::uint64_t held_bytes() const override {
        return ChunkedJob::held_bytes() + lease_.bytes();
    }
    Frames farewell() override;

protected:
    /// Ends trace(): the rays that it took, and the document.
    void finish(const Chunk& chunk, Traversal traversal, const JobStatistics::Counts& counts,
                const std::string& document);

    const std::string camera_;

private:
    [[nodiscard]] std::uint64_t chunk_size(const Backend& /*backend*/,
                                           const Chunk& /*rest*/) const override {
        return 1;
    }

    const Budget::Lease lease_;
    PayloadSender payload_;
    bool explained_ = false;
};

/// Reserves memory for a document of `entries` entries.
Reply<Budget::Lease> reserve_explanation(const Services& services, const Caller& caller,
                                         std::uint64_t entries, std::string_view fewer);
/// Returns the submission of such a job; the caller adds the job itself.
[[nodiscard]] JobSubmission accept_explanation(const Caller& caller, const Plan& plan,
                                               std::uint64_t bytes, std::string_view fewer);

/// Column and row, from the upper left corner.
using Pixel = std::array<std::uint32_t, 2>;
/// Checks that a pixel lies in a picture.
Reply<void> check_pixel(const Pixel& pixel, std::uint32_t width, std::uint32_t height);

/// The beginning of an encoding that asks for the path of a pixel: "path+480,270".
inline constexpr std::string_view path_encoding = "path+";
/// Explains the last sample of a pixel of a lit picture; `pixel` is the encoding behind its beginning.
Reply<Answer> explain_path(const Services& services, const Caller& caller,
                           const wire::Render& message, std::string_view pixel);

}  // namespace raynest::server

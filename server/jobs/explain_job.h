// The base of jobs that explain a ray or a path: one task traces, and the answer is one JSON
// document.
#pragma once

#include "server/jobs/chunked_job.h"
#include "server/jobs/payload_sender.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

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
    /// Ends trace(): the rays that it took, the document, and what the user is told beside it.
    void finish(const Chunk& chunk, Traversal traversal, const JobStatistics::Counts& counts,
                const std::string& document, std::vector<std::string> notes = {});

    const std::string camera_;

private:
    [[nodiscard]] std::uint64_t chunk_size(const Backend& /*backend*/,
                                           const Chunk& /*rest*/) const override {
        return 1;
    }

    const Budget::Lease lease_;
    PayloadSender payload_;
    bool explained_ = false;
    std::vector<std::string> notes_;
};

}  // namespace raynest::server

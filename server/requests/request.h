// The interface of requests. Each has a file, which answers it, and a row in the table of
// request.cpp.
//
// Its function runs on the io thread with a message that protocol::open() has verified. It returns
// an answer or a job. It never blocks and never uses a socket.
#pragma once

#include "protocol/control.h"
#include "server/jobs/services.h"
#include "server/scheduling/job.h"
#include "server/security/caller.h"
#include "server/security/role.h"

#include <cstdint>
#include <variant>

namespace raynest::server {

using Answer = std::variant<Frames, JobSubmission>;

// The handler of each request of requests.def.
#define RAYNEST_REQUEST(number, Name, handler, ...) \
    Reply<Answer> handler(const Services&, const Caller&, const protocol::Opened<wire::Name>&);
#include "protocol/lists/requests.def"

/// The object that must belong to the caller; otherwise the request fails with JOB_UNKNOWN. Rules
/// about scenes are checked by their requests (access.h).
enum class Needs { nothing, own_job };

/// A message that begins a request: a row of the table in request.cpp.
struct Request {
    wire::Message type;
    Role role;  ///< the least role of its sender; checked in one place, Conversation::start
    /// Checks Needs and answers the request.
    Reply<Answer> (*answer)(const Services&, const Caller&, const protocol::Frame&);
    /// Returns the time from now that the client allows; 0: any, or the message cannot be read.
    std::uint32_t (*deadline_ms)(const protocol::Frame&, const protocol::Limits&);
};

/// Returns the row of a message type; null for messages that begin no request.
[[nodiscard]] const Request* find_request(std::uint16_t type);

/// Makes an answer of one frame.
template <class Native>
Reply<Answer> answer_with(const Caller& caller, const Native& message, const Services& services) {
    Reply<protocol::Frame> frame = protocol::encode(caller.request_id, message, services.limits);
    if (!frame) return tl::unexpected(frame.error());
    Frames frames;
    frames.push_back(std::move(*frame));
    return Answer{std::move(frames)};
}

}  // namespace raynest::server

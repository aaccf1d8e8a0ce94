// The interface of handlers. Each request has a handler file and a row in the table of handler.cpp.
//
// A handler runs on the io thread with a message that protocol::open() has verified. It returns an
// answer or a job. It never blocks and never uses a socket.
#pragma once

#include "engine/assets/import.h"
#include "engine/packs/registry.h"
#include "protocol/control.h"
#include "server/backends/backends.h"
#include "server/ground/metrics.h"
#include "server/scheduling/detached.h"
#include "server/security/principal.h"
#include "server/ground/budget.h"
#include "server/store/scene_store.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <variant>
#include <vector>

namespace raynest::server {

class Administration;
class PageLogins;
class TraceBufferPool;

/// The parts of the daemon that handlers may use. One per daemon; outlives all jobs.
struct Services {
    const Registry& registry;
    SceneStore& scenes;  ///< io thread only
    Budget& budget;
    Metrics& metrics;
    const protocol::Limits& limits;
    ImportLimits import_limits;
    std::filesystem::path scene_root;       ///< empty: root:PATH is refused
    std::vector<std::string> import_child;  ///< command line of the import process
    Admission& admission;
    DetachedJobs& detached;
    Peers& peers;  ///< io thread only
    const Backends& backends;
    TraceBufferPool& trace_buffers;
    FairThreadPool& blocking;  ///< for tasks that wait for processes and disks
    std::string page = {};     ///< address of the daemon's page; empty: none
    Administration* administration = nullptr;  ///< null in tests without a whole daemon
    PageLogins* page_logins = nullptr;         ///< null likewise
};

/// A request and its connection.
struct Caller : ConnectionId {
    std::uint64_t request_id = 0;
    std::uint64_t window_bytes = 0;  ///< credit that the client grants to each request at its start
    Principal identity = {};
};

using Answer = std::variant<Frames, JobSubmission>;

// The handler of each request of requests.def.
#define RAYNEST_REQUEST(number, Name, handler, ...) \
    Reply<Answer> handler(const Services&, const Caller&, const protocol::Opened<wire::Name>&);
#include "protocol/requests.def"

class Conversation;

/// The object that must belong to the caller; otherwise the request fails with JOB_UNKNOWN. Rules
/// about scenes are checked by their handlers (access.h).
enum class Needs { nothing, own_job };

/// A message that a client may send: a row of the table in handler.cpp.
struct Request {
    wire::Message type;
    Role role;          ///< the least role of its sender; checked in one place, Conversation::start
    bool before_hello;  ///< true: allowed only before Hello is answered; false: only after
    /// Returns the maximum bytes of the bulk part; 0: the message has none.
    std::uint64_t (*bulk_bytes_max)(const protocol::Limits&);
    /// Checks Needs and answers the request. Null: the message is handled by `act`.
    Reply<Answer> (*answer)(const Services&, const Caller&, const protocol::Frame&);
    void (Conversation::*act)(protocol::Frame);
};

/// Returns the row of a message type; null for messages that clients do not send.
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

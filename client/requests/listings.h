// The lists of a daemon: its jobs, scenes and connections.
#pragma once

#include "client/net/connection.h"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace raynest::client {

/// Entries of a list that comes page by page: more than a daemon has, so that its pages end.
inline constexpr std::uint64_t listed_max = 1ULL << 20;
/// Fails beyond listed_max entries.
Result<void> check_listed(std::uint64_t count);

/// Returns "query", or "query closest".
[[nodiscard]] std::string job_kind(const wire::JobInfo& info);
/// Returns "job 17 (query closest, forest)".
[[nodiscard]] std::string job_text(const wire::JobInfo& info);
/// Passes on every job that the daemon lists, by number.
Result<void> each_job(Connection& connection,
                      const std::function<void(const wire::JobInfo&)>& consume);
/// Fails with the error of a failed job, as its own client would have read it.
Result<void> check_job(const wire::JobInfo& info);
/// The daemon's entry for a job. find_job() asks for a list that begins with the job's number, and
/// fails with JOB_UNKNOWN if the list begins with another.
struct FoundJob {
    Reply<wire::JobList> list;
    const wire::JobInfo* info = nullptr;
};
Result<FoundJob> find_job(Connection& connection, std::uint64_t number);

struct ListedScene {
    std::string name, hash, owner;
    std::string share;  ///< "", "public", or principals joined by commas
    std::uint64_t epoch = 0, triangles = 0, bytes = 0;
    double age_seconds = 0;     ///< since the load
    double idle_seconds = 0;    ///< since a request last used it
    std::uint32_t holders = 0;  ///< connections that loaded or opened it
    std::string state = {};     ///< memory, disk or damaged
};
Result<std::vector<ListedScene>> list_scenes(Connection& connection);

struct ListedConnection {
    std::uint64_t number = 0;
    std::string principal, role, transport, peer;
    double age_seconds = 0;
    std::uint32_t jobs = 0;
};

/// Passes on every connection, by number.
Result<void> each_connection(Connection& connection,
                             const std::function<void(const ListedConnection&)>& consume);

}  // namespace raynest::client

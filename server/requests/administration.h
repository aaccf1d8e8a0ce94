// The acts of an administrator on the running daemon.
#pragma once

#include "server/ground/errors.h"
#include "server/security/principal.h"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace raynest::server {

/// A row of `raynest admin connections`.
struct ConnectionRow {
    std::uint64_t number = 0;
    std::string principal;
    std::string role;
    std::string transport;
    std::string peer;
    std::uint64_t age_ms = 0;
    std::uint32_t jobs = 0;
};

/// Io thread only.
class Administration {
public:
    Administration() = default;
    Administration(const Administration&) = delete;

    /// Returns the connections with numbers above `after`, by number.
    [[nodiscard]] virtual std::vector<ConnectionRow> connections(std::uint64_t after) const = 0;
    /// Begins to end the daemon, as SIGTERM does.
    virtual void drain() = 0;
    /// Takes what a reload has read. Returns what happened; fails with FILE_UNUSABLE and the first
    /// mistake, after which the old content stays.
    using Take = std::function<Reply<std::string>()>;
    /// Begins to read certificates, tokens and the configuration again, as SIGHUP does: call what it
    /// returns on any thread, and what that returns on the io thread. Nothing changes before.
    [[nodiscard]] virtual std::function<Take()> reload() = 0;
    /// Ends one connection, or all of a principal. Returns their number.
    virtual std::size_t kick(std::uint64_t connection, const std::string& principal) = 0;
    /// True if the principal is connected, holds scenes or jobs, or has a row in the token file.
    [[nodiscard]] virtual bool knows(const std::string& principal) = 0;
    /// Replaces the quotas of a principal until the daemon ends.
    virtual void set_quota(const std::string& principal, const Quota& quota) = 0;

protected:
    ~Administration() = default;
};

}  // namespace raynest::server

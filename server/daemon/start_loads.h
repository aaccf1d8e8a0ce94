// Loads the scenes of --load after the start, one after the other, as the daemon's own user: it
// owns them, and they are shared with everybody.
//
//   sources ──glob──► files ──load_at_start()──► a detached job ──► "loaded" or "load_failed" in
//   the log
#pragma once

#include "server/net/asio.h"
#include "server/requests/request.h"
#include "server/scheduling/detached.h"

#include <cstddef>
#include <string>
#include <vector>

namespace raynest::server {

/// Io thread only.
class StartLoads {
public:
    StartLoads(asio::io_context& io, const Services& services) : services_(services), timer_(io) {}
    StartLoads(const StartLoads&) = delete;

    /// Begins to load (load_sources.h).
    /// A failure is logged with the source, and the next one follows.
    void start(const std::vector<std::string>& sources);
    /// Starts no more loads, because the daemon ends.
    void stop() { sources_.resize(next_); }
    /// Returns "the daemon loads its scenes: 1 of 3 …" until all loads have ended; then an empty
    /// text.
    [[nodiscard]] std::string unready() const;

private:
    void load_next();
    /// Starts the load of a source; false if it failed at once.
    bool begin(const std::string& source);
    void look();
    void end_load(const DetachedJob& job);

    const Services& services_;
    asio::steady_timer timer_;
    std::vector<std::string> sources_;
    std::size_t next_ = 0;   ///< index of the source to load next
    std::uint64_t job_ = 0;  ///< number of the load under way; 0: none
    Caller caller_;
};

}  // namespace raynest::server

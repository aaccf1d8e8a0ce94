// Reads the options of a running daemon again, and takes those that may change while it runs.
//
//   read_again(), any thread ──► reload_options(), io thread
//
//   options, files ──► weakened()? ──no──► all files usable? ──yes──► taken at once
//                          │                    └─no──► the old options of security stay
//                          └─yes──► all options of security that changed wait for a restart
#pragma once

#include "server/ground/errors.h"
#include "server/options/listen_policy.h"
#include "server/options/options.h"
#include "server/security/credentials.h"

#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// The result of a reload.
struct Reload {
    std::string changed;  ///< names of options that have another value from now on, with commas
    std::string needs_restart;  ///< names of those whose new value only a restart applies, likewise
    std::string weaker;         ///< why these include options of security; empty: they do not
    bool is_site_smaller = false;  ///< hosts or proxies of the page were taken away
    std::string fault;             ///< what is wrong with the options or a file; empty: nothing
};

/// The result of reading for a reload.
struct ReadAgain {
    Result<Options> then;
    Credentials::Files wanted;               ///< files of the options of security of `then`
    std::optional<Credentials::Files> kept;  ///< those of the options before, if they differ
};

/// Calls `read`, and reads the files of security. `now` are the options that are in force. Any
/// thread.
[[nodiscard]] ReadAgain read_again(const std::function<Result<Options>()>& read,
                                   const SecurityOptions& now);

/// Takes values of what was read into `now` that may change while the daemon runs: the level and form
/// of the log, security, --http-host, fewer proxies, and the limits that the io thread alone reads.
/// Takes the files of security. `open` are the addresses listened on. Logs what a restart is needed
/// for, and what is open to whom if that has changed.
[[nodiscard]] Reload reload_options(Options& now, ReadAgain read, Credentials& credentials,
                                    const std::vector<ListenAddress>& open);

/// Logs the result, and returns it in words for an administrator. Fails with FILE_UNUSABLE.
[[nodiscard]] Reply<std::string> told(const Reload& done);

/// Writes only limits that differ: compute threads read those that never do.
void take_limits(protocol::Limits& now, const protocol::Limits& then);

/// Logs what each address is open to.
void log_openness(const std::vector<ListenAddress>& open, const Options& options);

}  // namespace raynest::server

// The options of the commands on jobs and on the page, as CLI11 declares them. Included by options.cpp alone.
#pragma once

#include "client/commands/option_parts.h"

#include <cstdint>

namespace raynest::client {

inline void add_job_number(CLI::App& app, std::uint64_t& job) {
    add_whole(app, "ID", job, std::uint64_t{1}, any_whole, "number of a job (see: raynest jobs)")
        ->required();
}

inline void declare(CLI::App& app, TopOptions& top) {
    app.add_flag("--once", top.once, "print one look at a second of the daemon's work, and end");
}
inline void declare(CLI::App& app, OpenOptions& open) {
    app.add_option("SCENE", open.source,
                   "name of a loaded scene (the first one); or FILE.glb, builtin:NAME and so on, "
                   "which is loaded as by raynest load");
}
inline void declare(CLI::App&, JobsOptions&) {}
inline void declare(CLI::App& app, WaitOptions& wait) {
    add_job_number(app, wait.job);
    add_deadline(app, wait.deadline, "stop waiting after this many seconds; the job goes on");
}
inline void declare(CLI::App& app, FetchOptions& fetch) {
    add_job_number(app, fetch.job);
    add_output(app, fetch.output, {".png", ".exr", ".npy", ".npz"},
               "file of the kind that the job makes (a query without it: a table on stdout)");
}
inline void declare(CLI::App& app, CancelOptions& cancel) {
    add_job_number(app, cancel.job);
}

}  // namespace raynest::client

// raynest jobs: lists running jobs, and detached jobs with kept answers.
#include "client/jobs.h"

#include "client/commands/commands.h"
#include "client/output.h"

namespace raynest::client {
namespace {

/// Returns "41%", the stage if the end is unknown, or "-".
std::string progress_text(const wire::JobInfo& info) {
    if (info.total() == 0) return std::string(protocol::word(info.stage(), "-"));
    return std::to_string(static_cast<int>(100 * static_cast<double>(info.done()) /
                                           static_cast<double>(info.total()))) +
           "%";
}

std::string time_text(std::uint64_t milliseconds) {
    return seconds_text(static_cast<double>(milliseconds) / 1e3);
}

}  // namespace

Result<void> run(Context& context, const JobsOptions&) {
    Json jobs = Json::array();
    std::vector<std::vector<std::string>> rows = {
        {"JOB", "OWNER", "KIND", "SCENE", "STATE", "PROGRESS", "AGE", "LEFT", "KEPT", "WORKER"}};
    wire::JobsT request;
    for (bool more = true; more;) {
        const auto page = ask<wire::JobList>(context.connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        more = (*page)->more();
        if ((*page)->jobs() == nullptr) break;
        for (const wire::JobInfo* info : *(*page)->jobs()) {
            jobs.push_back(job_json(*info));
            rows.push_back({std::to_string(info->job()), std::string(protocol::text(info->owner())),
                            job_kind(*info), std::string(protocol::text(info->scene())),
                            std::string(protocol::text(info->state())), progress_text(*info),
                            time_text(info->age_ms()),
                            info->left_ms() == 0 ? "-" : time_text(info->left_ms()),
                            info->detached() ? bytes_text(info->bytes()) : "-",
                            std::string(protocol::text(info->worker()))});
            request.after = info->job();
        }
    }
    if (context.json)
        print_json(Json{{"jobs", jobs}});
    else
        print_table(rows);
    return {};
}

}  // namespace raynest::client

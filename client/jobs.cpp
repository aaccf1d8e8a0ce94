#include "client/jobs.h"

#include "client/wording.h"

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

Json job_json(const wire::JobInfo& info) {
    Json json{
        {"job", info.job()},
        {"owner", protocol::text(info.owner())},
        {"kind", protocol::text(info.kind())},
        {"detail", protocol::text(info.detail())},
        {"scene", protocol::text(info.scene())},
        {"state", protocol::text(info.state())},
        {"detached", info.detached()},
        {"stage", protocol::text(info.stage())},
        {"done", info.done()},
        {"total", info.total()},
        {"age_seconds", static_cast<double>(info.age_ms()) / 1e3},
        {"left_seconds",
         info.left_ms() == 0 ? Json(nullptr) : Json(static_cast<double>(info.left_ms()) / 1e3)},
        {"bytes", info.bytes()},
        {"worker", protocol::text(info.worker())},
        {"error",
         info.code() == 0 ? Json(nullptr) : Json(localize_message(protocol::text(info.error())))}};
    return json;
}

std::string job_kind(const wire::JobInfo& info) {
    const std::string_view detail = protocol::text(info.detail());
    return std::string(protocol::text(info.kind())) +
           (detail.empty() ? "" : " " + std::string(detail));
}

std::string job_text(const wire::JobInfo& info) {
    return "job " + std::to_string(info.job()) + " (" + job_kind(info) + ", " +
           std::string(protocol::text(info.scene())) + ")";
}

std::vector<std::string> job_header() {
    return {"JOB",      "OWNER", "KIND", "SCENE", "STATE",
            "PROGRESS", "AGE",   "LEFT", "KEPT",  "WORKER"};
}

std::vector<std::string> job_row(const wire::JobInfo& info) {
    return {std::to_string(info.job()),
            std::string(protocol::text(info.owner())),
            job_kind(info),
            std::string(protocol::text(info.scene())),
            std::string(protocol::text(info.state())),
            progress_text(info),
            time_text(info.age_ms()),
            info.left_ms() == 0 ? "-" : time_text(info.left_ms()),
            info.detached() ? bytes_text(info.bytes()) : "-",
            std::string(protocol::text(info.worker()))};
}

Result<void> each_job(Connection& connection,
                      const std::function<void(const wire::JobInfo&)>& consume) {
    wire::JobsT request;
    for (bool more = true; more;) {
        const auto page = ask<wire::JobList>(connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        more = (*page)->more();
        if ((*page)->jobs() == nullptr) break;
        for (const wire::JobInfo* info : *(*page)->jobs()) {
            consume(*info);
            request.after = info->job();
        }
    }
    return {};
}

Result<void> check_job(const wire::JobInfo& info) {
    if (info.code() == 0) return {};
    Failure why =
        failure({static_cast<protocol::Code>(info.code()),
                 job_text(info) + " failed: " + std::string(protocol::text(info.error())), 0});
    why.lost = false;  // it is the job that ended, not the connection
    return tl::unexpected<Failure>(std::move(why));
}

Result<FoundJob> find_job(Connection& connection, std::uint64_t number) {
    wire::JobsT request;
    request.after = number == 0 ? 0 : number - 1;
    auto list = ask<wire::JobList>(connection, request);
    if (!list) return tl::unexpected<Failure>(list.error());
    const auto* jobs = (*list)->jobs();
    if (jobs == nullptr || jobs->size() == 0 || jobs->Get(0)->job() != number)
        return tl::unexpected<Failure>(failure(
            {protocol::Code::job_unknown,
             "there is no job " + std::to_string(number) + ", or its answer is gone; see `Jobs`",
             0}));
    return FoundJob{std::move(*list), jobs->Get(0)};
}

}  // namespace raynest::client

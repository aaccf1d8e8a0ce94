#include "client/jobs.h"

#include "client/wording.h"

namespace raynest::client {

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

Result<void> check_job(const wire::JobInfo& info) {
    if (info.code() == 0) return {};
    return tl::unexpected<Failure>(
        failure({static_cast<protocol::Code>(info.code()),
                 job_text(info) + " failed: " + std::string(protocol::text(info.error())), 0}));
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

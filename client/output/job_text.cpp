#include "client/output/job_text.h"

#include "client/ground/text.h"
#include "client/ground/wording.h"

#include <algorithm>

namespace raynest::client {
namespace {

/// Returns "41%", the stage if the end is unknown, or "-".
std::string progress_text(const wire::JobInfo& info) {
    if (info.total() == 0) return std::string(protocol::word(info.stage(), "-"));
    const auto done = static_cast<double>(std::min(info.done(), info.total()));
    return std::to_string(static_cast<int>(100 * done / static_cast<double>(info.total()))) + "%";
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

std::vector<std::string> job_header() {
    return {"JOB", "OWNER", "KIND", "SCENE", "STATE", "PROGRESS", "AGE", "LEFT", "KEPT", "WORKER"};
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

}  // namespace raynest::client

// raynest cancel ID: cancels a job and drops its answer.
#include "client/arguments/shared_options.h"
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/output/job_text.h"
#include "client/output/output.h"
#include "client/requests/listings.h"

#include <iostream>

namespace raynest::client {
namespace {

struct CancelOptions {
    std::uint64_t job = 0;
};

}  // namespace

void declare(CommandLine& line, CancelOptions& cancel) {
    add_job_number(line, cancel.job);
}

Result<void> run(Context& context, const CancelOptions& options) {
    wire::CancelJobT request;
    request.job = options.job;
    const auto info = ask<wire::JobInfo>(context.connection, request);
    if (!info) return tl::unexpected<Failure>(info.error());
    if (context.json) {
        // The entry is from before: the daemon has dropped the answer now.
        Json job = job_json(*info->message.table);
        job["bytes"] = 0;
        job["left_seconds"] = nullptr;
        print_json(job);
        return {};
    }
    std::cout << "cancelled " << job_text(*info->message.table) << '\n';
    return {};
}

std::unique_ptr<Command> make_cancel() {
    return make_command<CancelOptions>();
}

}  // namespace raynest::client

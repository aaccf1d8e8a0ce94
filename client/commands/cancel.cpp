// raynest cancel ID: ends a job, and drops what is kept of it.
#include "client/commands/commands.h"
#include "client/jobs.h"

#include <iostream>

namespace raynest::client {

Result<void> run(Context& context, const CancelOptions& options) {
    wire::CancelJobT request;
    request.job = options.job;
    const auto info = ask<wire::JobInfo>(context.connection, request);
    if (!info) return tl::unexpected<Failure>(info.error());
    if (context.json)
        print_json(job_json(*info->message.table));
    else
        std::cout << "cancelled " << job_text(*info->message.table) << '\n';
    return {};
}

}  // namespace raynest::client

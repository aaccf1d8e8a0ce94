// raynest wait ID: waits until a detached job has ended.
#include "client/arguments/shared_options.h"
#include "client/commands/command.h"
#include "client/ground/interrupt.h"
#include "client/ground/text.h"
#include "client/output/job_text.h"
#include "client/output/output.h"
#include "client/requests/job.h"
#include "client/requests/listings.h"

#include <iostream>
#include <string>

namespace raynest::client {
namespace {

struct WaitOptions {
    std::uint64_t job = 0;
    double deadline = 0;  ///< seconds; 0 = none
};

}  // namespace

void declare(CommandLine& line, WaitOptions& wait) {
    add_job_number(line, wait.job);
    add_deadline(line, wait.deadline, "stop waiting after this many seconds; the job goes on");
}

Result<void> run(Context& context, const WaitOptions& options) {
    wire::WaitT request;
    request.job = options.job;
    const auto deadline = deadline_of(options.deadline);
    request.deadline_ms = static_cast<std::uint32_t>(deadline.count());
    if (auto started = context.connection.start(request, deadline); !started) return started;
    while (true) {
        auto frame = context.connection.next();
        if (!frame && interrupted()) {
            const std::string number = std::to_string(options.job);
            return fail(Exit::interrupted, "interrupted; job " + number +
                                               " goes on, unless you: raynest cancel " + number);
        }
        if (!frame && frame.error().exit == Exit::deadline) {
            const std::string number = std::to_string(options.job);
            return fail(Exit::deadline, "job " + number + " still runs: raynest wait " + number +
                                            " again, or raynest cancel " + number);
        }
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (is<wire::Progress>(*frame)) {
            const auto news = open_sent<wire::Progress>(*frame);
            if (!news) return tl::unexpected<Failure>(news.error());
            context.progress.update((*news)->done(), (*news)->total(),
                                    protocol::text((*news)->stage()));
        }
        if (!is<wire::JobInfo>(*frame)) continue;
        context.progress.clear();
        const auto info = open_reply<wire::JobInfo>(std::move(*frame));
        if (!info) return tl::unexpected<Failure>(info.error());
        if (auto well = check_job(*info->message.table); !well) return well;
        if (context.json)
            print_json(job_json(*info->message.table));
        else
            std::cout << job_text(*info->message.table) << " is done, "
                      << bytes_text((*info)->bytes()) << "; raynest fetch " << options.job
                      << " -o FILE brings the answer\n";
        return {};
    }
}

std::unique_ptr<Command> make_wait() {
    return make_command<WaitOptions>();
}

}  // namespace raynest::client

// raynest jobs: lists running jobs, and detached jobs with kept answers.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/output/job_text.h"
#include "client/output/output.h"
#include "client/requests/listings.h"

namespace raynest::client {
namespace {

struct JobsOptions {};

}  // namespace

void declare(CommandLine&, JobsOptions&) {}

Result<void> run(Context& context, const JobsOptions&) {
    Json jobs = Json::array();
    std::vector<std::vector<std::string>> rows = {job_header()};
    const auto listed = each_job(context.connection, [&](const wire::JobInfo& info) {
        jobs.push_back(job_json(info));
        rows.push_back(job_row(info));
    });
    if (!listed) return listed;
    if (context.json)
        print_json(Json{{"jobs", jobs}});
    else
        print_table(rows);
    return {};
}

std::unique_ptr<Command> make_jobs() {
    return make_command<JobsOptions>();
}

}  // namespace raynest::client

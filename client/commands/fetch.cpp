// raynest fetch ID [-o FILE]: delivers the answer of a detached job in the form that its own
// command gives.
#include "client/arguments/shared_options.h"
#include "client/commands/deliver.h"
#include "client/files/files.h"
#include "client/output/output_file.h"
#include "client/requests/listings.h"

namespace raynest::client {
namespace {

/// Checks that the file has the format that the job has made.
Result<void> check_ending(const std::string& output, const std::string& ending) {
    if (output == standard_stream || extension_of(output) == ending) return {};
    return fail(Exit::usage, "the job made a FILE" + ending + ", not '" + output + "'");
}

}  // namespace

void declare(CommandLine& line, FetchOptions& fetch) {
    add_job_number(line, fetch.job);
    add_output(line, fetch.output, {".png", ".exr", ".npy", ".npz"},
               "file of the kind that the job makes (a query without it: a table on stdout)");
}

Result<void> run(Context& context, const FetchOptions& options) {
    const auto job = find_job(context.connection, options.job);
    if (!job) return tl::unexpected<Failure>(job.error());
    const std::string kind(protocol::text(job->info->kind()));
    wire::FetchT request;
    request.job = options.job;

    if (kind == "query") {
        if (!options.output.empty())
            if (auto fits = check_ending(options.output, ".npz"); !fits) return fits;
        return deliver_query(
            context, options.output, std::string(protocol::text(job->info->detail())),
            [&](const ChunkConsumer& consume) {
                return fetch_query(context.connection, request, context.progress, consume);
            });
    }

    if (kind == "blame") {
        if (!options.output.empty())
            return fail(Exit::usage, job_text(*job->info) +
                                         " is a ranking, which is printed: leave "
                                         "out -o");
        if (auto started = context.connection.start(request); !started) return started;
        const auto answer = receive_picture(context.connection, context.progress, document_room());
        context.progress.clear();
        if (!answer) return tl::unexpected<Failure>(answer.error());
        return deliver_ranking(context, *answer);
    }

    if (options.output.empty())
        return fail(Exit::usage, job_text(*job->info) + " is a picture: pass -o FILE");
    if (auto writable = check_writable(options.output); !writable) return writable;
    if (auto started = context.connection.start(request); !started) return started;
    auto picture =
        receive_picture(context.connection, context.progress, picture_room(kind != "render"));
    context.progress.clear();
    if (!picture) return tl::unexpected<Failure>(picture.error());
    const std::string ending = "." + (picture->encode == "raw" ? "npy" : picture->encode);
    if (auto fits = check_ending(options.output, ending); !fits) return fits;
    if (kind == "render") return deliver_render(context, options.output, std::move(*picture));
    return deliver_heatmap(context, options.output, std::move(*picture));
}

}  // namespace raynest::client

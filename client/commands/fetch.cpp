// raynest fetch ID [-o FILE]: delivers the answer of a detached job in the form that its own
// command gives.
#include "client/arguments/shared_options.h"
#include "client/commands/deliver.h"
#include "client/files/files.h"
#include "client/files/points.h"
#include "client/output/output_file.h"
#include "client/requests/generator.h"
#include "client/requests/listings.h"

namespace raynest::client {
namespace {

struct FetchOptions {
    std::uint64_t job = 0;
    std::string output;
    std::vector<std::string> generate;  ///< the words of the job's --generate
};

/// The columns of a job's sensor, which its answer does not have.
Result<SensorColumns> columns_of_sensor(const FetchOptions& options, const wire::JobInfo& job) {
    const auto generate = parse_generate(options.generate);
    if (!generate) return tl::unexpected<Failure>(generate.error());
    wire::GeneratorT generator = generate->at({});
    if (const auto sent = read_sent_numbers(*generate, {}, generator); !sent)
        return tl::unexpected<Failure>(sent.error());
    std::vector<std::string> names = SensorColumns::of(generator);
    if (names.empty())
        return fail(Exit::usage,
                    "--generate " + generator.kind + " has no ring and no time: leave it out");
    if (sensor_rays(generator) != job.total())
        return fail(Exit::usage, job_text(job) + " has " + std::to_string(job.total()) +
                                     " rays, and this --generate " +
                                     std::to_string(sensor_rays(generator)) +
                                     ": give that of the job");
    return SensorColumns::take(names, &generator);
}

/// Checks that the file has the format that the job has made.
Result<void> check_ending(const std::string& output, const std::string& ending) {
    if (output == standard_stream || extension_of(output) == ending) return {};
    return fail(Exit::usage, "the job made a FILE" + ending + ", not '" + output + "'");
}

}  // namespace

void declare(CommandLine& line, FetchOptions& fetch) {
    add_job_number(line, fetch.job);
    add_output(line, fetch.output, {".png", ".exr", ".npy", ".npz", ".ply", ".pcd", ".las"},
               "file of the kind that the job makes; of a query FILE.npz or a point cloud (without "
               "it: a table on stdout)");
    add_generate(
        line, fetch.generate,
        "KIND key=value...: the sensor of the job, as raynest query had it: adds its columns ring "
        "and time to the file");
}

Result<void> run(Context& context, const FetchOptions& options) {
    const auto job = find_job(context.connection, options.job);
    if (!job) return tl::unexpected<Failure>(job.error());
    const std::string kind(protocol::text(job->info->kind()));
    wire::FetchT request;
    request.job = options.job;

    if (kind == "query") {
        if (!options.output.empty() && !is_point_ending(extension_of(options.output)))
            if (auto fits = check_ending(options.output, ".npz"); !fits) return fits;
        const std::string what(protocol::text(job->info->detail()));
        SensorColumns sensor;
        if (!options.generate.empty()) {
            if (options.output.empty() || find_reducer(what) != nullptr)
                return fail(Exit::usage, "--generate is for -o FILE, of a query without --reduce");
            auto taken = columns_of_sensor(options, *job->info);
            if (!taken) return tl::unexpected<Failure>(taken.error());
            sensor = std::move(*taken);
        }
        return deliver_query(context, options.output, what, [&](const ChunkConsumer& consume) {
            return fetch_query(context.connection, request, context.progress,
                               sensor.empty() ? consume : with_columns(sensor, 0, consume));
        });
    }
    if (!options.generate.empty())
        return fail(Exit::usage, "--generate is for queries, and " + job_text(*job->info) +
                                     " is none: leave it out");

    if (kind == "blame") {
        if (!options.output.empty())
            return fail(Exit::usage, job_text(*job->info) +
                                         " is a ranking, which is printed: leave "
                                         "out -o");
        if (auto started = context.connection.start(request); !started) return started;
        const auto answer = receive_file(context.connection, context.progress, document_room());
        context.progress.clear();
        if (!answer) return tl::unexpected<Failure>(answer.error());
        return deliver_ranking(context, *answer);
    }

    if (options.output.empty())
        return fail(Exit::usage, job_text(*job->info) + " is a picture: pass -o FILE");
    if (auto writable = check_writable(options.output); !writable) return writable;
    if (auto started = context.connection.start(request); !started) return started;
    auto picture =
        receive_file(context.connection, context.progress, picture_room(kind != "render"));
    context.progress.clear();
    if (!picture) return tl::unexpected<Failure>(picture.error());
    const std::string ending = "." + (picture->encode == "raw" ? "npy" : picture->encode);
    if (auto fits = check_ending(options.output, ending); !fits) return fits;
    if (kind == "render") return deliver_render(context, options.output, std::move(*picture));
    return deliver_heatmap(context, options.output, std::move(*picture));
}

std::unique_ptr<Command> make_fetch() {
    return make_command<FetchOptions>();
}

}  // namespace raynest::client

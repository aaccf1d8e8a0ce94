// raynest query SCENE --ray ... | --rays FILE | --generate KIND ...: traces rays and gives their
// hits as a table, as JSON lines, as a .npz of columns or as a point cloud.
#include "client/requests/query.h"

#include "client/arguments/shared_options.h"
#include "client/commands/by_python.h"
#include "client/commands/deliver.h"
#include "client/files/files.h"
#include "client/files/points.h"
#include "client/ground/json.h"
#include "client/ground/lists.h"
#include "client/requests/generator.h"
#include "client/requests/scene_origin.h"
#include "protocol/hash.h"
#include "protocol/parts.h"

#include <algorithm>
#include <array>
#include <span>

namespace raynest::client {
namespace {

wire::QueryT query_message(const QueryOptions& options) {
    wire::QueryT request;
    request.job = job_message(options.job);
    request.reduce = options.reduce;
    request.kind = options.kind;
    const ReducerWords* reducer = find_reducer(options.reduce);
    if (request.kind.empty()) request.kind = reducer != nullptr ? reducer->kind : "closest";
    request.fields = options.fields;
    const std::string ending = extension_of(options.output);
    if (request.fields.empty() && is_point_ending(ending)) {
        request.fields = {"position"};
        if (ending != ".las") request.fields.insert(request.fields.end(), {"t", "inst"});
        wire::GeneratorT sensor;
        if (!options.generate.empty()) sensor.kind = options.generate.front();
        if (!options.job.detach)
            for (std::string& name : SensorColumns::of(sensor))
                request.fields.push_back(std::move(name));
    }
    if (request.fields.empty() && request.reduce.empty())
        request.fields = default_fields(request.kind);
    request.max_hits = options.max_hits;
    return request;
}

/// Answers a query without rays: sends one invalid ray, because a query needs one, and passes on
/// only the columns. Errors and types are thus those of any other query.
Result<Outcome> ask_about_no_rays(Context& context, wire::QueryT& request, const RaySource& rays,
                                  const ChunkConsumer& consume) {
    if (request.job->detach)
        return fail(Exit::usage,
                    "a detached job needs rays, and there are none; leave --detach out");
    request.ray_count = 1;
    if (request.generator != nullptr) {
        auto& settings = request.generator->settings;
        std::erase_if(settings,
                      [](const std::string& each) { return each.starts_with("samples="); });
        settings.emplace_back("samples=1");
    }
    const RaySource invalid(std::vector<float>(rays.width()), rays.width(), rays.common_origin());
    auto outcome = run_query(
        context.connection, request, invalid, context.progress, [&](const QueryChunk& chunk) {
            std::vector<protocol::BlockView> columns(chunk.columns.begin(), chunk.columns.end());
            for (protocol::BlockView& column : columns) column.count = 0, column.bytes = {};
            return consume({0, 0, chunk.splits.first(1), columns, {}, chunk.hidden});
        });
    if (outcome) outcome->rays = outcome->misses = outcome->invalid = 0;
    return outcome;
}

/// A point cloud needs points that were hit, and all of them.
Result<void> check_points(const QueryOptions& options, const wire::QueryT& request) {
    if (!is_point_ending(extension_of(options.output))) return {};
    if (request.kind == "any" || !request.reduce.empty())
        return fail(Exit::usage, options.output +
                                     " needs hits: leave --kind any and --reduce out, "
                                     "or write a .npz");
    const std::string_view place = place_of(request.fields);
    if (place.empty())
        return fail(Exit::usage, options.output +
                                     " needs the column position among --fields, or "
                                     "sensor_position for points in the sensor's frame");
    if (extension_of(options.output) == ".las")
        for (const std::string& field : request.fields)
            if (auto fits = check_las_column(field); field != place && !fits) return fits;
    if (options.part.count != 0)
        return fail(Exit::usage,
                    "--part needs -o FILE.npz, which raynest merge makes point clouds of, too");
    return {};
}

/// Returns what tells these rays and their masks, or this trajectory, from others: a path says not
/// what is in it.
std::string content_of(const RaySource& rays, std::span<const std::byte> trajectory) {
    constexpr std::uint64_t at_once = 1 << 16;
    std::uint64_t hash = protocol::upload_checksum(std::as_bytes(rays.masks()));
    std::vector<float> values;
    for (std::uint64_t first = 0; first < rays.count(); first += at_once) {
        values.resize(std::min(at_once, rays.count() - first) * rays.width());
        rays.read(first, values);
        hash = protocol::upload_checksum(std::as_bytes(std::span(values)), hash);
    }
    if (const auto& from = rays.common_origin()) {
        const std::array origin{from->x(), from->y(), from->z()};
        hash = protocol::upload_checksum(std::as_bytes(std::span(origin)), hash);
    }
    hash = protocol::upload_checksum(trajectory, hash);
    return std::to_string(rays.count()) + " rays, " + std::to_string(hash);
}

/// The words of --generate without those that name files, which are in content_of().
std::vector<std::string> without_files(std::vector<std::string> words) {
    std::erase_if(words, [](const std::string& word) {
        return word.starts_with("points=") || word.starts_with("trajectory=") ||
               word.ends_with(".npy");
    });
    return words;
}

/// Leaves the rays or points of --part. Returns what its file says: which rows of which request it
/// has.
Result<Json> take_part(const QueryOptions& options, wire::QueryT& request, RaySource& rays,
                       std::span<const std::byte> trajectory) {
    if (options.output.empty() || options.job.detach)
        return fail(Exit::usage, "--part needs -o FILE.npz, and goes without --detach");
    const bool sensor = request.generator != nullptr && rays.count() == 0;
    const std::uint64_t all = sensor ? sensor_rays(*request.generator) : rays.count();
    std::uint64_t step = sensor ? sensor_band(*request.generator) : 1;
    if (options.part.count > all / step) step = 1;
    const std::string content = content_of(rays, trajectory);
    const auto range = part_of(options.part, all, step, sensor ? "rays" : "rays or points");
    if (!range) return tl::unexpected<Failure>(range.error());
    if (!sensor) rays.keep(*range);
    if (request.generator != nullptr) {
        request.part_first = range->first;
        request.part_count = range->count;
    }
    const auto common = protocol::common_bytes(request);
    const auto digest =
        protocol::upload_checksum(std::as_bytes(std::span(common.data(), common.size())));
    const JobOptions& job = options.job;
    // The words say what another request has, and the digest knows all options.
    return Json{{"first", range->first},
                {"count", range->count},
                {"of", all},
                {"kind", request.kind},
                {"fields", request.fields},
                {"reduce", request.reduce},
                {"max_hits", request.max_hits},
                {"generate", without_files(options.generate)},
                {"step_error", options.step_error},
                {"time", job.time ? Json(*job.time) : Json()},
                {"animation", job.animation},
                {"rays", content},
                {"intersector", job.intersector},
                {"set", job.settings},
                {"mask", job.mask},
                {"hide", job.hide},
                {"only", job.only},
                {"request", std::to_string(digest)}};
}

void warn_of_rounding(Context& context, const RaySource& rays, const SceneOrigin& scene,
                      std::string_view subject = {}) {
    const std::string warning = rounding_warning(rays, scene, subject);
    if (warning.empty()) return;
    context.progress.clear();
    print_note(warning);
}

}  // namespace

void declare(CommandLine& line, QueryOptions& query) {
    add_job(line, query.job);
    add_moment(line, query.job);
    CommandLine rays = line.add_choice("Rays", "one of");
    rays.add_each(
        "--ray",
        [&query](const std::string& text) -> Result<void> {
            const auto ray = parse_ray(text);
            if (!ray) return tl::unexpected<Failure>(ray.error());
            query.rays.push_back(*ray);
            return {};
        },
        std::string(ray_form) + ", in the order of files; may be repeated");
    const Option file =
        rays.add_option("--rays", query.rays_file,
                        "FILE.npy of shape (N, 6): o d, or (N, 8): ox oy oz tmin dx dy dz tmax, "
                        "or with --from (N, 3): d; - for stdin");
    add_generate(rays, query.generate, "KIND key=value...: the daemon makes them, as listed below");
    line.add_option("--step-error", query.step_error,
                    "METRES: an animated scene moves while the sensor measures, in steps; no part "
                    "is further than this from where it should be (step_error= of --generate "
                    "sweep and rolling_shutter)");
    add_point(line, "--from", "start of all rays; --rays then holds their directions",
              [&query](const WorldPoint& point) { query.from = point; })
        .needs(file);
    add_measure(line, query);
    line.add_option(
        "--masks", query.masks_file,
        "FILE.npy of shape (N,): a mask for each ray or point that is sent; bits that --mask lacks "
        "do not count; at most 64 different ones");
    line.add_parsed(
            "--origin",
            [](const std::string&) -> std::string {
                return "is an option of load, and the scene keeps it; where rays start is said "
                       "with --from x,y,z";
            },
            "")
        .hidden();
    line.footer(generate_help() + exit_codes());
    add_kind(line, query.kind, query.max_hits, query.fields);
    line.add_option(
        "--reduce", query.reduce,
        "one row per point or path instead of one per ray: " + alternatives(reduce_words));
    add_output(line, query.output, {".npz", ".ply", ".pcd", ".las"},
               "FILE.npz of columns, or a point cloud: FILE.ply, .pcd or .las (else a table on "
               "stdout)");
    add_detach(line, query.job, nullptr);
    add_part(line, query.part);
}

Result<void> run(Context& context, const QueryOptions& options) {
    wire::QueryT request = query_message(options);
    if (auto fits = check_points(options, request); !fits) return fits;
    const auto scene = ask_origin(context.connection, options.job.scene);
    if (!scene) return tl::unexpected<Failure>(scene.error());
    const WorldPoint& origin = scene->point;
    // A detached job does not tell which epoch it found, so name it.
    if (options.job.detach && options.job.epoch == 0) request.job->epoch = scene->epoch;
    if (options.generate.empty() && !options.step_error.empty())
        return fail(Exit::usage, "--step-error is for --generate sweep and rolling_shutter");
    std::string points;
    std::vector<std::byte> trajectory;
    if (!options.generate.empty()) {
        const auto generate = parse_generate(options.generate);
        if (!generate) return tl::unexpected<Failure>(generate.error());
        points = generate->points;
        if (const auto at = generate->start())
            warn_of_rounding(context,
                             RaySource({{(*at)[0], (*at)[1], (*at)[2], 0, 0, 0, -1, 1}}, origin),
                             *scene, "the sensor stands");
        request.generator = std::make_unique<wire::GeneratorT>(generate->at(origin));
        if (!options.step_error.empty())
            request.generator->settings.push_back("step_error=" + options.step_error);
        auto sent = read_sent_numbers(*generate, origin, *request.generator);
        if (!sent) return tl::unexpected<Failure>(sent.error());
        trajectory = std::move(*sent);
    }
    context.progress.update(0, 0, "reading");
    Result<RaySource> rays = RaySource(options.rays, origin);
    if (!options.rays_file.empty()) rays = RaySource::open(options.rays_file, options.from, origin);
    if (!points.empty()) rays = RaySource::open_points(points, origin);
    if (!rays) return tl::unexpected<Failure>(rays.error());
    if (!options.masks_file.empty()) {
        if (request.generator != nullptr && points.empty())
            return fail(Exit::usage,
                        "--masks are of rays that are sent: with --generate give one --mask");
        if (auto taken = rays->open_masks(options.masks_file); !taken) return taken;
    }
    Json part;
    if (options.part.count != 0) {
        auto taken = take_part(options, request, *rays, trajectory);
        if (!taken) return tl::unexpected<Failure>(taken.error());
        part = std::move(*taken);
    }
    const auto own = SensorColumns::take(request.fields, request.generator.get());
    if (!own) return tl::unexpected<Failure>(own.error());
    if (!own->empty() && options.job.detach)
        return fail(Exit::usage, "the column " + own->names().front() +
                                     " is made when the answer is fetched: leave it out of "
                                     "--fields, and give raynest fetch this --generate");
    if (!own->empty() && !request.reduce.empty())
        return fail(Exit::usage, "the column " + own->names().front() + " goes without --reduce");
    request.ray_count = rays->count();
    warn_of_rounding(context, *rays, *scene);
    // Rows need these columns, shown or hidden, to tell hits, misses and invalid rays apart; points
    // in a file need them too. A detached job may become rows when it is fetched.
    const auto need = [&request](const char* name) {
        if (std::ranges::find(request.fields, name) != request.fields.end()) return;
        request.fields.emplace_back(name);
        request.hidden.emplace_back(name);
    };
    const bool may_be_rows = options.output.empty() || options.job.detach;
    const bool has_points =
        !place_of(request.fields).empty() || is_point_ending(extension_of(options.output));
    if (request.reduce.empty()) {
        if ((may_be_rows || has_points) && !has_splits(request.kind)) need("hit");
        if (may_be_rows) need("flags");
        if (request.fields.empty() && !own->empty()) need("hit");
    }

    return deliver_query(
        context, options.output, request.reduce.empty() ? request.kind : request.reduce,
        [&](const ChunkConsumer& consume) {
            if (!own->empty())
                return run_query(context.connection, request, *rays, context.progress,
                                 with_columns(*own, request.part_first, consume), trajectory);
            const bool sends = request.generator == nullptr || !points.empty();
            if (sends && rays->count() == 0)
                return ask_about_no_rays(context, request, *rays, consume);
            return run_query(context.connection, request, *rays, context.progress, consume,
                             trajectory);
        },
        part);
}

namespace {

class Query final : public PythonCommandOf<QueryOptions> {
    [[nodiscard]] bool is_safe(const Failure& why) const override {
        return is_job_safe(options_.job, why) &&
               (options_.rays_file.empty() || is_file(options_.rays_file)) &&
               (options_.masks_file.empty() || is_file(options_.masks_file));
    }
    [[nodiscard]] std::optional<Parts> parts() const override {
        Parts parts{1, options_.output, options_.part.count != 0};
        const auto generate = parse_generate(options_.generate);
        if (options_.rays_file.empty() && options_.rays.empty() && generate &&
            generate->points.empty())
            parts.most = std::max<std::uint64_t>(1, sensor_rays(generate->message) / part_rays);
        return parts;
    }
};

}  // namespace

std::unique_ptr<Command> make_query() {
    return std::make_unique<Query>();
}

}  // namespace raynest::client

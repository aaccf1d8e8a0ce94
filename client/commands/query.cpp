// raynest query SCENE --ray ... | --rays FILE | --generate KIND ...: traces rays and gives their
// hits as a table, as JSON lines or as a .npz of columns.
#include "client/query.h"

#include "client/commands/deliver.h"
#include "client/generator.h"
#include "client/npy.h"
#include "client/output.h"
#include "client/output_file.h"
#include "client/query_rows.h"
#include "client/scene_origin.h"

#include <algorithm>
#include <functional>
#include <iostream>
#include <map>
#include <optional>

namespace raynest::client {
namespace {

std::string numpy_dtype(wire::Dtype dtype) {
    switch (dtype) {
        case wire::Dtype::u8:
            return "|u1";
        case wire::Dtype::u32:
            return "<u4";
        case wire::Dtype::u64:
            return "<u8";
        case wire::Dtype::f32:
            return "<f4";
    }
    return "|u1";
}

/// Joins chunks to whole columns.
class Columns {
public:
    explicit Columns(bool splits) : has_splits_(splits) {}

    Result<void> append(const QueryChunk& chunk) {
        for (const protocol::BlockView& block : chunk.columns) {
            if (!chunk.shows(block.name)) continue;
            if (is_point_field(block.name) && block.dtype == wire::Dtype::f32 &&
                block.width() == 3) {
                append_points(chunk, block);
                continue;
            }
            Column& column = columns_[std::string(block.name)];
            if (column.bytes.empty()) column.dtype = block.dtype, column.width = block.width();
            if (column.dtype != block.dtype || column.width != block.width())
                return fail(Exit::failed, "the daemon changed a column's type between chunks");
            column.count += block.count;
            column.bytes.insert(column.bytes.end(), block.bytes.begin(), block.bytes.end());
        }
        for (std::uint32_t i = 0; i < chunk.count; ++i)
            splits_.push_back(splits_.back() + chunk.splits[i + 1] - chunk.splits[i]);
        return {};
    }

    [[nodiscard]] std::vector<std::byte> npz() const {
        std::vector<NamedArray> arrays;
        if (has_splits_)
            arrays.push_back(
                {"ray_splits", {"<i8", {splits_.size()}, std::as_bytes(std::span(splits_))}});
        for (const auto& [name, column] : columns_) {
            std::vector<std::uint64_t> shape = {column.count};
            if (column.width > 1) shape.push_back(column.width);
            const bool is_truth = column.dtype == wire::Dtype::u8 && is_truth_field(name);
            const std::string dtype = column.is_world ? "<f8"
                                      : is_truth      ? "|b1"
                                                      : numpy_dtype(column.dtype);
            arrays.push_back({name, {dtype, shape, column.bytes}});
        }
        return format_npz(arrays);
    }

private:
    struct Column {
        wire::Dtype dtype = wire::Dtype::u8;
        std::uint32_t width = 1;
        std::uint64_t count = 0;
        std::vector<std::byte> bytes;
        bool is_world = false;  ///< a point: float64 in the file
    };

    /// Appends points in the world; the position of a miss stays 0.
    void append_points(const QueryChunk& chunk, const protocol::BlockView& block) {
        Column& column = columns_[std::string(block.name)];
        column.width = 3, column.is_world = true;
        const protocol::BlockView* hit = protocol::find_block(chunk.columns, "hit");
        const bool tells = hit != nullptr && hit->count == block.count &&
                           block.name == "position" && hit->dtype == wire::Dtype::u8;
        const std::span<const float> points = block.values<float>();
        for (std::uint64_t i = 0; i < 3 * block.count; ++i) {
            const bool missed = tells && hit->bytes[i / 3] == std::byte{0};
            const double value = double{points[i]} + (missed ? 0 : chunk.origin[i % 3]);
            const auto bytes = std::as_bytes(std::span(&value, 1));
            column.bytes.insert(column.bytes.end(), bytes.begin(), bytes.end());
        }
        column.count += block.count;
    }

    bool has_splits_;
    std::map<std::string, Column> columns_;
    std::vector<std::uint64_t> splits_ = {0};
};

wire::QueryT query_message(const QueryOptions& options) {
    wire::QueryT request;
    request.job = job_message(options.job);
    request.reduce = options.reduce;
    request.kind = options.kind;
    const ReducerWords* reducer = find_reducer(options.reduce);
    if (request.kind.empty()) request.kind = reducer != nullptr ? reducer->kind : "closest";
    request.fields = options.fields;
    if (request.fields.empty() && request.reduce.empty())
        request.fields = default_fields(request.kind);
    request.max_hits = options.max_hits;
    return request;
}

/// Returns a consumer that prints rows of those columns of `first` that users asked for.
ChunkConsumer row_printer(const std::string& what, const QueryChunk& first, bool json) {
    if (const ReducerWords* reducer = find_reducer(what))
        return [rows = ReducedRows(reducer->rows == "points" ? "point" : "", json)](
                   const QueryChunk& chunk) mutable { return rows.print(chunk); };
    std::vector<std::string> shown;
    for (const protocol::BlockView& column : first.columns)
        if (first.shows(column.name)) shown.emplace_back(column.name);
    return [rows = QueryRows(what, shown, json)](const QueryChunk& chunk) mutable {
        return rows.print(chunk);
    };
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

void warn_of_rounding(Context& context, const RaySource& rays, const SceneOrigin& scene,
                      std::string_view subject = {}) {
    const std::string warning = rounding_warning(rays, scene, subject);
    if (warning.empty()) return;
    context.progress.clear();
    print_note(warning);
}

/// Fails with the code for a partial answer if rays had more hits than --max-hits.
Result<void> check_whole(const Outcome& outcome) {
    if (outcome.truncated == 0) return {};
    return fail(Exit::partial, grouped(outcome.truncated) + " of " + grouped(outcome.rays) +
                                   " rays have more hits than --max-hits, of which the nearest "
                                   "were kept; raise it");
}

}  // namespace

Result<void> run(Context& context, const QueryOptions& options) {
    wire::QueryT request = query_message(options);
    const auto scene = ask_origin(context.connection, options.job.scene);
    if (!scene) return tl::unexpected<Failure>(scene.error());
    const WorldPoint& origin = scene->point;
    // A detached job does not tell which epoch it found, so name it.
    if (options.job.detach && options.job.epoch == 0) request.job->epoch = scene->epoch;
    std::string points;
    if (!options.generate.empty()) {
        const auto generate = parse_generate(options.generate);
        if (!generate) return tl::unexpected<Failure>(generate.error());
        points = generate->points;
        if (const auto at = generate->start())
            warn_of_rounding(context,
                             RaySource({{(*at)[0], (*at)[1], (*at)[2], 0, 0, 0, -1, 1}}, origin),
                             *scene, "the sensor stands");
        request.generator = std::make_unique<wire::GeneratorT>(generate->at(origin));
    }
    context.progress.update(0, 0, "reading");
    Result<RaySource> rays = RaySource(options.rays, origin);
    if (!options.rays_file.empty()) rays = RaySource::open(options.rays_file, options.from, origin);
    if (!points.empty()) rays = RaySource::open_points(points, origin);
    if (!rays) return tl::unexpected<Failure>(rays.error());
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
    const bool has_points = std::ranges::any_of(request.fields, is_point_field);
    if (request.reduce.empty()) {
        if ((may_be_rows || has_points) && !has_splits(request.kind)) need("hit");
        if (may_be_rows) need("flags");
    }

    return deliver_query(
        context, options.output, request.reduce.empty() ? request.kind : request.reduce,
        [&](const ChunkConsumer& consume) {
            const bool sends = request.generator == nullptr || !points.empty();
            if (sends && rays->count() == 0)
                return ask_about_no_rays(context, request, *rays, consume);
            return run_query(context.connection, request, *rays, context.progress, consume);
        });
}

Result<void> deliver_query(Context& context, const std::string& output, const std::string& what,
                           const std::function<Result<Outcome>(const ChunkConsumer&)>& ask) {
    const bool rows = output.empty();
    if (!rows) {
        if (auto writable = check_writable(output); !writable) return writable;
    }
    ChunkConsumer print;
    Columns columns(has_splits(what));
    const auto outcome = ask([&](const QueryChunk& chunk) {
        if (!rows) return columns.append(chunk);
        if (!print) print = row_printer(what, chunk, context.json);
        context.progress.clear();
        return print(chunk);
    });
    context.progress.clear();
    if (!outcome) return tl::unexpected<Failure>(outcome.error());
    print_notes(*outcome);
    if (outcome->detached != 0) {
        print_detached(context, *outcome);
        return {};
    }
    if (rows) {
        if (outcome->rays == 0) print_note(outcome_text(*outcome));
        return check_whole(*outcome);
    }

    if (auto written = write_file(output, columns.npz()); !written) return written;
    if (context.json) {
        Json json = outcome_json(*outcome);
        json["file"] = output;
        print_json(json, summary_of(output));
    } else {
        summary_of(output) << output << ": " << outcome_text(*outcome) << '\n';
    }
    return check_whole(*outcome);
}

void print_detached(const Context& context, const Outcome& outcome) {
    if (context.json)
        print_json(Json{{"job", outcome.detached}});
    else
        std::cout << outcome.detached << '\n';
}

}  // namespace raynest::client

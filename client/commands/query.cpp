// raynest query SCENE --ray ... | --rays FILE | --generate KIND ...: what rays hit, as a table, as
// JSON lines or as a .npz of columns.
#include "client/query.h"

#include "client/commands/deliver.h"
#include "client/files.h"
#include "client/generator.h"
#include "client/npy.h"
#include "client/query_rows.h"

#include <algorithm>
#include <functional>
#include <iostream>
#include <map>
#include <optional>

namespace raynest::client {
namespace {

std::vector<std::string> default_fields(const std::string& kind) {
    if (kind == "any") return {"hit"};
    return {"t", "prim", "geom", "path", "uv"};
}

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

/// Grows whole columns out of chunks.
class Columns {
public:
    explicit Columns(bool splits) : has_splits_(splits) {}

    Result<void> append(const QueryChunk& chunk) {
        for (const protocol::BlockView& block : chunk.columns) {
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
                {"ray_splits", {"<u8", {splits_.size()}, std::as_bytes(std::span(splits_))}});
        for (const auto& [name, column] : columns_) {
            std::vector<std::uint64_t> shape = {column.count};
            if (column.width > 1) shape.push_back(column.width);
            arrays.push_back({name, {numpy_dtype(column.dtype), shape, column.bytes}});
        }
        return format_npz(arrays);
    }

private:
    struct Column {
        wire::Dtype dtype = wire::Dtype::u8;
        std::uint32_t width = 1;
        std::uint64_t count = 0;
        std::vector<std::byte> bytes;
    };
    bool has_splits_;
    std::map<std::string, Column> columns_;
    std::vector<std::uint64_t> splits_ = {0};
};

wire::QueryT query_message(const QueryOptions& options) {
    wire::QueryT request;
    request.job = job_message(options.job);
    request.reduce = options.reduce;
    request.kind = options.kind;
    if (request.kind.empty()) request.kind = options.reduce == "hit_fraction" ? "any" : "closest";
    request.fields = options.fields;
    if (request.fields.empty() && request.reduce.empty())
        request.fields = default_fields(request.kind);
    request.max_hits = options.max_hits;
    return request;
}

/// The columns that rows show of an answer; `hit` is how they tell misses from hits.
std::vector<std::string> names_of(const QueryChunk& chunk, const std::string& kind) {
    std::vector<std::string> names;
    for (const protocol::BlockView& column : chunk.columns)
        if (column.name != "hit" || kind == "any") names.emplace_back(column.name);
    return names;
}

/// Prints rows of the columns `shown`, of those of `first` when that is empty.
ChunkConsumer row_printer(const std::string& what, const std::vector<std::string>& shown,
                          const QueryChunk& first, bool json) {
    if (what == "hit_fraction" || what == "visible_pixels")
        return [rows = ReducedRows(what == "hit_fraction" ? "point" : "", json)](
                   const QueryChunk& chunk) mutable { return rows.print(chunk); };
    return [rows = QueryRows(what, shown.empty() ? names_of(first, what) : shown, json)](
               const QueryChunk& chunk) mutable { return rows.print(chunk); };
}

/// A truncated answer was given, and is a partial one.
Result<void> check_whole(const Outcome& outcome) {
    if (outcome.truncated == 0) return {};
    return fail(Exit::partial, grouped(outcome.truncated) + " of " + grouped(outcome.rays) +
                                   " rays have more hits than --max-hits, of which the nearest "
                                   "were kept; raise it");
}

}  // namespace

Result<void> run(Context& context, const QueryOptions& options) {
    wire::QueryT request = query_message(options);
    std::string points;
    if (!options.generate.empty()) {
        auto generate = parse_generate(options.generate);
        if (!generate) return tl::unexpected<Failure>(generate.error());
        points = generate->points;
        request.generator = std::make_unique<wire::GeneratorT>(std::move(generate->message));
    }
    Result<RaySource> rays = RaySource(options.rays);
    if (!options.rays_file.empty()) rays = RaySource::open(options.rays_file, options.origin);
    if (!points.empty()) rays = RaySource::open_points(points);
    if (!rays) return tl::unexpected<Failure>(rays.error());
    request.ray_count = rays->count();
    const std::vector<std::string> shown = request.fields;
    // Rows tell misses from hits by this column, shown or not.
    const std::vector<std::string>& fields = request.fields;
    const bool has_hit = std::find(fields.begin(), fields.end(), "hit") != fields.end();
    if (options.output.empty() && request.reduce.empty() && !has_splits(request.kind) && !has_hit)
        request.fields.push_back("hit");

    return deliver_query(
        context, options.output, request.reduce.empty() ? request.kind : request.reduce, shown,
        [&](const ChunkConsumer& consume) {
            return run_query(context.connection, request, *rays, context.progress, consume);
        });
}

Result<void> deliver_query(Context& context, const std::string& output, const std::string& what,
                           const std::vector<std::string>& shown,
                           const std::function<Result<Outcome>(const ChunkConsumer&)>& ask) {
    const bool rows = output.empty();
    if (!rows) {
        if (auto writable = check_writable(output); !writable) return writable;
    }
    ChunkConsumer print;
    Columns columns(has_splits(what));
    const auto outcome = ask([&](const QueryChunk& chunk) {
        if (!rows) return columns.append(chunk);
        if (!print) print = row_printer(what, shown, chunk, context.json);
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
    if (rows) return check_whole(*outcome);

    if (auto written = write_file(output, columns.npz()); !written) return written;
    if (context.json) {
        Json json = outcome_json(*outcome);
        json["truncated"] = outcome->truncated;
        json["file"] = output;
        print_json(json);
    } else {
        std::cout << output << ": " << outcome_text(*outcome) << '\n';
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

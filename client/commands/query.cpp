// raynest query SCENE --ray ...: what rays hit, as a table, as JSON lines or as a .npz of columns.
#include "client/query.h"

#include "client/commands/deliver.h"
#include "client/files.h"
#include "client/npy.h"
#include "client/query_rows.h"

#include <algorithm>
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
    explicit Columns(bool multi) : multi_(multi) {}

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
        if (multi_)
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
    bool multi_;
    std::map<std::string, Column> columns_;
    std::vector<std::uint64_t> splits_ = {0};
};

/// The columns that rows show of an answer; `hit` is how they tell misses from hits.
std::vector<std::string> names_of(const QueryChunk& chunk, const std::string& kind) {
    std::vector<std::string> names;
    for (const protocol::BlockView& column : chunk.columns)
        if (column.name != "hit" || kind == "any") names.emplace_back(column.name);
    return names;
}

}  // namespace

Result<void> run(Context& context, const QueryOptions& options) {
    Result<RaySource> rays =
        options.rays_file.empty() ? RaySource(options.rays) : RaySource::open(options.rays_file);
    if (!rays) return tl::unexpected<Failure>(rays.error());
    const bool rows = options.output.empty();

    wire::QueryT request;
    request.job = job_message(options.job);
    request.kind = options.kind.empty() ? "closest" : options.kind;
    request.fields = options.fields.empty() ? default_fields(request.kind) : options.fields;
    request.max_hits = options.max_hits;
    request.ray_count = rays->count();
    const std::vector<std::string> shown = request.fields;
    // Rows tell misses from hits by this column, shown or not.
    const bool has_hit = std::find(shown.begin(), shown.end(), "hit") != shown.end();
    if (rows && request.kind != "multi" && !has_hit) request.fields.push_back("hit");

    return deliver_query(
        context, options.output, request.kind, shown, [&](const ChunkConsumer& consume) {
            return run_query(context.connection, request, *rays, context.progress, consume);
        });
}

Result<void> deliver_query(Context& context, const std::string& output, const std::string& kind,
                           const std::vector<std::string>& shown,
                           const std::function<Result<Outcome>(const ChunkConsumer&)>& ask) {
    const bool rows = output.empty();
    if (!rows) {
        if (auto writable = check_writable(output); !writable) return writable;
    }
    std::optional<QueryRows> printer;
    Columns columns(kind == "multi");
    const auto outcome = ask([&](const QueryChunk& chunk) {
        if (!rows) return columns.append(chunk);
        if (!printer)
            printer.emplace(kind, shown.empty() ? names_of(chunk, kind) : shown, context.json);
        context.progress.clear();
        return printer->print(chunk);
    });
    context.progress.clear();
    if (!outcome) return tl::unexpected<Failure>(outcome.error());
    print_notes(*outcome);
    if (outcome->detached != 0) print_detached(context, *outcome);
    if (rows || outcome->detached != 0) return {};

    if (auto written = write_file(output, columns.npz()); !written) return written;
    if (context.json) {
        Json json = outcome_json(*outcome);
        json["file"] = output;
        print_json(json);
    } else {
        std::cout << output << ": " << outcome_text(*outcome) << '\n';
    }
    return {};
}

void print_detached(const Context& context, const Outcome& outcome) {
    if (context.json)
        print_json(Json{{"job", outcome.detached}});
    else
        std::cout << outcome.detached << '\n';
}

}  // namespace raynest::client

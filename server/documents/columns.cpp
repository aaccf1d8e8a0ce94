#include "server/documents/columns.h"

#include "protocol/blocks.h"
#include "protocol/control.h"
#include "server/store/late_velocities.h"

#include <algorithm>
#include <cstring>

namespace raynest::server {
namespace {

wire::Dtype dtype(FieldType type) {
    switch (type) {
        case FieldType::u8:
            return wire::Dtype::u8;
        case FieldType::u32:
            return wire::Dtype::u32;
        case FieldType::u64:
            return wire::Dtype::u64;
        case FieldType::f32:
            return wire::Dtype::f32;
    }
    return wire::Dtype::u8;
}

bool per_ray(const Column& column, Query query) {
    const bool csr = query == query_multi || query == query_all;
    return !csr || field_info(column.field).of_ray;
}

/// The hits of a multi or all query without gaps, with the ray of each.
struct Compacted {
    std::vector<std::uint64_t> splits;
    std::vector<std::uint32_t> ray_of;
    std::vector<HitRecord> rays;  ///< one per ray; only `hit` and the flags are set
};

Compacted compact(const Plan& plan, const TracedRays& traced) {
    const std::size_t rays = traced.rows();
    Compacted result;
    result.splits.reserve(rays + 1);
    result.splits.push_back(0);
    result.rays.resize(rays);
    std::size_t end = 0;
    for (std::size_t ray = 0; ray < rays; ++ray) {
        const std::size_t count = traced.counts[ray];
        if (plan.query == query_multi) {
            const HitRecord* from = traced.hits.data() + ray * plan.hits_max;
            result.rays[ray].flags = from->flags;
            std::copy_n(from, count, traced.hits.data() + end);
        } else {
            result.rays[ray].flags = traced.flags[ray];
        }
        result.rays[ray].hit = count != 0 ? 1 : 0;
        result.ray_of.insert(result.ray_of.end(), count, static_cast<std::uint32_t>(ray));
        end += count;
        result.splits.push_back(end);
    }
    return result;
}

/// A column and the place of its next element.
struct Target {
    Column column;
    std::byte* out;
};

/// Writes `count` elements of each column. Works in blocks of records that stay in the L1 cache
/// while all columns read them.
void write_columns(std::span<Target> columns, const ColumnSource& all, std::size_t count) {
    constexpr std::size_t block = 512;
    for (std::size_t at = 0; at < count; at += block) {
        const std::size_t n = std::min(block, count - at);
        ColumnSource part = all;
        if (all.ray_of.empty() && !all.sensors.empty()) part.sensors = all.sensors.subspan(at, n);
        if (!all.order.empty()) {
            part.order = all.order.subspan(at, n);
        } else {
            if (!all.hits.empty()) part.hits = all.hits.subspan(at, n);
            if (all.ray_of.empty())
                part.rays = all.rays.subspan(at, n);
            else
                part.ray_of = all.ray_of.subspan(at, n);
        }
        if (!all.counters.empty())
            part.counters = all.counters.subspan(at * all.counter_sets, n * all.counter_sets);
        for (Target& target : columns) {
            write_column(target.column, part, target.out);
            target.out += n * field_bytes(target.column.field);
        }
    }
}

}  // namespace

Reply<Columns> Columns::choose(std::span<const std::string> names, Query query) {
    Columns columns;
    std::vector<Column>& chosen = columns.columns_;
    for (const std::string& name : names) {
        const auto column = parse_column(name);
        if (!column) {
            columns.outputs_.push_back(name);
            continue;
        }
        if (query == query_any && !field_info(column->field).of_ray)
            return refuse(Code::invalid_field,
                          "column '" + name +
                              "' is not defined for kind any: which surface an any-hit meets "
                              "depends on the traversal; ask for hit, or use kind closest");
        if (query == query_all && field_info(column->field).counter)
            return refuse(Code::invalid_field,
                          "column '" + name +
                              "' is not counted for kind all; use kind closest, any or multi");
        if (std::find(chosen.begin(), chosen.end(), *column) == chosen.end())
            chosen.push_back(*column);
    }
    const auto shown = query == query_any ? FieldInfo::Shown::any : FieldInfo::Shown::hits;
    for (std::uint32_t i = 0; names.empty() && i < field_table().size(); ++i)
        if (field_table()[i].shown == shown) chosen.emplace_back(static_cast<Field>(i));
    return columns;
}

Reply<void> Columns::check_outputs(const Variant& variant) const {
    for (const std::string& name : outputs_) {
        const auto outputs = variant.outputs();
        const bool known =
            std::any_of(outputs.begin(), outputs.end(),
                        [&](const PackOutput& output) { return name == output.name; });
        if (!known) return refuse(parse_column(name).error());
    }
    return {};
}

CounterMode Columns::counters() const {
    const auto any = [&](const auto& wanted) {
        return std::any_of(columns_.begin(), columns_.end(), wanted);
    };
    if (any([](const Column& column) { return column.of_level(); })) return counters_by_level;
    return any([](const Column& column) { return field_info(column.field).counter; })
               ? counters_total
               : counters_none;
}

Reply<void> Columns::check_levels(const SceneView& scene) const {
    for (const Column& column : columns_)
        if (const auto known = check_level(column, scene.objects[scene.root].levels); !known)
            return refuse(known.error());
    return {};
}

bool Columns::read_rays() const {
    return std::any_of(columns_.begin(), columns_.end(),
                       [](const Column& column) { return field_info(column.field).reads_rays; });
}

bool Columns::read_sensor() const {
    return std::any_of(columns_.begin(), columns_.end(),
                       [](const Column& column) { return field_info(column.field).reads_sensor; });
}

bool Columns::read_motion() const {
    return std::any_of(columns_.begin(), columns_.end(),
                       [](const Column& column) { return field_info(column.field).reads_motion; });
}

Columns::Cost Columns::cost(const Plan& plan) const {
    Cost cost;
    const std::size_t outputs = plan.variant->outputs().size();
    const std::size_t splits = plan.csr() ? 1 : 0;
    cost.fixed =
        (columns_.size() + outputs + splits) * protocol::alignment + splits * sizeof(std::uint64_t);
    cost.per_ray = outputs * sizeof(std::uint32_t) + splits * sizeof(std::uint64_t);
    for (const Column& column : columns_)
        (per_ray(column, plan.query) ? cost.per_ray : cost.per_hit) += field_bytes(column.field);
    return cost;
}

Reply<protocol::Frame> Columns::encode(const Plan& plan, const Registry& registry, std::uint64_t id,
                                       std::uint64_t first_ray, const TracedRays& traced,
                                       JobStatistics& statistics,
                                       std::span<const SensorAt> sensors) const {
    const bool many = plan.csr();
    const std::size_t rows = traced.rows();
    Compacted csr;
    if (many) csr = compact(plan, traced);
    const std::uint64_t hit_count = many ? csr.splits.back() : rows;

    // Lay out the blocks: splits, then fields in the order of the request, then outputs.
    protocol::Bulk bulk;
    if (many) bulk.add(splits_column, wire::Dtype::u64, 1, rows + 1);
    const std::size_t first_column = bulk.count();
    for (const Column& column : columns_) {
        const FieldInfo& info = field_info(column.field);
        bulk.add(column_name(column), dtype(info.type), info.width,
                 per_ray(column, plan.query) ? rows : hit_count);
    }
    std::vector<std::size_t> output_blocks;
    for (const PackOutput& output : plan.variant->outputs())
        output_blocks.push_back(bulk.add(
            output.name, output.type == value_f32 ? wire::Dtype::f32 : wire::Dtype::u32, 1, rows));
    bulk.allocate();

    if (many)
        std::copy(csr.splits.begin(), csr.splits.end(), bulk.block_as<std::uint64_t>(0).begin());
    std::vector<Target> of_rays;
    std::vector<Target> of_hits;
    of_rays.reserve(columns_.size());
    of_hits.reserve(columns_.size());
    for (std::size_t i = 0; i < columns_.size(); ++i)
        (per_ray(columns_[i], plan.query) ? of_rays : of_hits)
            .push_back({columns_[i], bulk.block(first_column + i).data()});
    ColumnSource source = plan.source(registry);
    source.rays = traced.rays;
    source.sensors = sensors;
    if (const auto& velocities = plan.scene.held->velocities; velocities && read_motion())
        source.velocities = &velocities->get();
    if (many) {
        source.hits = traced.hits.first(hit_count);
        source.ray_of = csr.ray_of;
        write_columns(of_hits, source, hit_count);
    }
    source.hits = many ? std::span<const HitRecord>(csr.rays) : traced.hits;
    source.ray_of = {};
    source.order = traced.order;
    source.counters = traced.counters;
    if (plan.counters != counters_none) source.counter_sets = plan.counter_sets();
    write_columns(of_rays, source, rows);
    for (std::size_t i = 0; i < output_blocks.size(); ++i)
        std::memcpy(bulk.block(output_blocks[i]).data(), traced.outputs[i].data() + traced.first,
                    rows * sizeof(std::uint32_t));

    JobStatistics::Counts counts;
    counts.rays = rows;
    counts.add_rays(source.hits, source.order, first_ray);
    if (plan.untraced) counts.misses = rows;
    counts.hits = many ? hit_count : rows - counts.misses;
    statistics.add(traced.backend, traced.traversals, counts);

    wire::ChunkT chunk;
    chunk.first_ray = first_ray;
    chunk.count = static_cast<std::uint32_t>(rows);
    return protocol::encode(id, std::move(chunk), std::move(bulk));
}

}  // namespace raynest::server

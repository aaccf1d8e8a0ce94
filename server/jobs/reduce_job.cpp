#include "server/jobs/reduce_job.h"

#include "protocol/text.h"
#include "server/jobs/services.h"
#include "server/scheduling/peers.h"

#include <algorithm>
#include <atomic>
#include <map>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Returns the statistics of a chunk whose first ray is `first_ray`.
JobStatistics::Counts count_hits(const TracedRays& traced, std::uint64_t first_ray) {
    JobStatistics::Counts counts;
    counts.rays = traced.hits.size();
    counts.add_rays(traced.hits, traced.order, first_ray);
    counts.hits = counts.rays - counts.misses;
    return counts;
}

Reply<Frames> rows_frame(std::uint64_t id, std::uint64_t first, std::uint64_t count,
                         protocol::Bulk bulk) {
    wire::ChunkT chunk;
    chunk.first_ray = first;
    chunk.count = static_cast<std::uint32_t>(count);
    auto frame = protocol::encode(id, std::move(chunk), std::move(bulk));
    if (!frame) return tl::unexpected(frame.error());
    Frames frames;
    frames.push_back(std::move(*frame));
    return frames;
}

/// Reducer hit_fraction: the share of each point's rays that hit something. A chunk holds whole
/// points, or a part of a point with more rays than a chunk may have; the part that ends last sends
/// the point's answer.
class FractionJob final : public QueryJob {
public:
    FractionJob(const Services& services, const Caller& caller, Plan plan, RaySource source)
        : QueryJob(services, caller, std::move(plan), std::move(source)),
          points_max_((frame_bytes_max(caller) - protocol::alignment) / sizeof(float)) {}

protected:
    [[nodiscard]] std::uint64_t chunk_size(const Backend& backend,
                                           const Chunk& rest) const override {
        const std::uint64_t each = source_.rays_per_point();
        const std::uint64_t most = backend.call_rays_max(plan_);
        return each > most ? std::min(most, each - rest.first % each) : each * chunk_points(most);
    }
    [[nodiscard]] std::uint64_t reply_bytes(std::uint64_t rays) const override {
        const std::uint64_t points = std::max<std::uint64_t>(1, rays / source_.rays_per_point());
        return protocol::padded(points * sizeof(float));
    }
    [[nodiscard]] std::uint64_t rows() const override {
        return source_.rays() / source_.rays_per_point();
    }
    [[nodiscard]] std::uint64_t result_bytes() const override {
        const std::uint64_t points =
            chunk_points(plan_.backends.order.back()->call_rays_max(plan_));
        return reply_bytes(source_.rays()) +
               (rows() / points + 1) * (protocol::alignment + answer_head_bytes_max);
    }

    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override {
        const auto traced = source_.trace(plan_, chunk, input_, stop, buffers, false);
        if (!traced) return tl::unexpected(traced.error());
        const std::uint64_t each = source_.rays_per_point();
        std::vector<std::uint32_t> hits(std::max<std::uint64_t>(1, chunk.count / each));
        for (std::uint64_t i = 0; i < chunk.count; ++i) hits[i / each] += traced->hits[i].hit;
        const bool whole = chunk.count >= each || add_part(chunk, hits.front());
        auto frames = whole ? fractions(chunk.first / each, hits) : Reply<Frames>(Frames{});
        if (!frames) return tl::unexpected(TraceFailure(frames.error()));
        statistics_.add(chunk.backend, traced->traversals, count_hits(*traced, chunk.first));
        answered(chunk, chunk.count);
        return std::move(*frames);
    }

private:
    /// Returns the number of whole points per chunk, at least 1.
    [[nodiscard]] std::uint64_t chunk_points(std::uint64_t rays_max) const {
        return std::clamp<std::uint64_t>(rays_max / source_.rays_per_point(), 1, points_max_);
    }
    /// Adds a part of a point. Returns true for the last part, and sets `hits` to the sum of all.
    bool add_part(const Chunk& chunk, std::uint32_t& hits) {
        const std::uint64_t each = source_.rays_per_point();
        const std::lock_guard lock(mutex_);
        const auto part = parts_.try_emplace(chunk.first / each).first;
        part->second.rays += chunk.count;
        hits = part->second.hits += hits;
        if (part->second.rays < each) return false;
        parts_.erase(part);
        return true;
    }
    [[nodiscard]] Reply<Frames> fractions(std::uint64_t first_point,
                                          std::span<const std::uint32_t> hits) const {
        protocol::Bulk bulk;
        bulk.add("hit_fraction", wire::Dtype::f32, 1, hits.size());
        bulk.allocate();
        const auto each = static_cast<double>(source_.rays_per_point());
        std::transform(hits.begin(), hits.end(), bulk.block_as<float>(0).begin(),
                       [&](std::uint32_t count) { return static_cast<float>(count / each); });
        return rows_frame(id_, first_point, hits.size(), std::move(bulk));
    }

    struct PartialSum {
        std::uint64_t rays = 0;
        std::uint32_t hits = 0;
    };
    const std::uint64_t points_max_;  ///< maximum points per answer
    std::mutex mutex_;
    std::map<std::uint64_t, PartialSum> parts_;  ///< sums of points that are traced in parts
};

/// Reducer visible_pixels: the number of rays whose closest hit is on each instance path. Tasks add
/// up counts; after the last one the table is sorted and sent in frames of rows.
class VisibleJob final : public QueryJob {
public:
    VisibleJob(const Services& services, const Caller& caller, Plan plan, RaySource source,
               std::uint64_t paths_max, Budget::Lease lease)
        : QueryJob(services, caller, std::move(plan), std::move(source)),
          frame_rows_(std::min(services.limits.chunk_rays_max,
                               (frame_bytes_max(caller) - 2 * protocol::alignment) / row_bytes)),
          paths_max_(paths_max),
          lease_(std::move(lease)) {}

    /// Bytes held per path: an entry of the map and a row of the table.
    static constexpr std::uint64_t path_bytes = 80;

    std::optional<Task> next() override {
        if (auto task = QueryJob::next()) return task;
        if (!queue_.all_answered()) return std::nullopt;
        if (!sorted_) return sorting_ ? std::nullopt : std::optional(sort_task());
        if (sent_ == table_.size()) return std::nullopt;
        return rows_task();
    }
    [[nodiscard]] bool finished() const override { return sorted_ && sent_ == table_.size(); }
    [[nodiscard]] std::uint64_t held_bytes() const override {
        return QueryJob::held_bytes() + lease_.bytes();
    }

protected:
    [[nodiscard]] std::uint64_t chunk_size(const Backend& backend,
                                           const Chunk& /*rest*/) const override {
        return source_.chunk_rays(backend.call_rays_max(plan_));
    }
    [[nodiscard]] std::uint64_t reply_bytes(std::uint64_t /*rays*/) const override { return 0; }
    [[nodiscard]] std::uint64_t rows() const override { return table_.size(); }
    [[nodiscard]] std::uint64_t result_bytes() const override {
        const std::uint64_t frames = paths_max_ / frame_rows_ + 1;
        return paths_max_ * row_bytes + frames * (2 * protocol::alignment + answer_head_bytes_max);
    }

    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override {
        const auto plan = plan_of(chunk);
        const auto traced = trace_rays_of(*plan, chunk, stop, buffers, true);
        if (!traced) return tl::unexpected(traced.error());
        std::unordered_map<std::uint64_t, std::uint32_t> counts;
        for (const HitRecord& hit : traced->hits)
            if (hit.hit != 0) ++counts[hit.path];
        {
            const std::lock_guard lock(mutex_);
            for (const auto& [path, count] : counts) counts_[path] += count;
        }
        statistics_.add(chunk.backend, traced->traversals, count_hits(*traced, chunk.first));
        answered(chunk, chunk.count);
        return Frames{};
    }

private:
    using Row = std::pair<std::uint64_t, std::uint32_t>;  ///< path, rays
    static constexpr std::uint64_t row_bytes = sizeof(std::uint64_t) + sizeof(std::uint32_t);

    Task sort_task() {
        sorting_ = true;
        Task task;
        task.run = [this](const Stop&) -> Reply<Frames> {
            table_.assign(counts_.begin(), counts_.end());
            std::sort(table_.begin(), table_.end());
            sorted_ = true;
            return Frames{};
        };
        return task;
    }

    Task rows_task() {
        const std::uint64_t first = sent_;
        const std::uint64_t count = std::min(frame_rows_, table_.size() - first);
        sent_ += count;
        Task task;
        task.reply_bytes_max = count * row_bytes + 2 * protocol::alignment;
        task.run = [this, first, count](const Stop&) -> Reply<Frames> {
            protocol::Bulk bulk;
            bulk.add("path", wire::Dtype::u64, 1, count);
            bulk.add("pixels", wire::Dtype::u32, 1, count);
            bulk.allocate();
            const std::span<const Row> rows = std::span(table_).subspan(first, count);
            std::transform(rows.begin(), rows.end(), bulk.block_as<std::uint64_t>(0).begin(),
                           [](const Row& row) { return row.first; });
            std::transform(rows.begin(), rows.end(), bulk.block_as<std::uint32_t>(1).begin(),
                           [](const Row& row) { return row.second; });
            return rows_frame(id_, first, count, std::move(bulk));
        };
        return task;
    }

    const std::uint64_t frame_rows_;
    const std::uint64_t paths_max_;
    const Budget::Lease lease_;
    std::mutex mutex_;
    std::unordered_map<std::uint64_t, std::uint32_t> counts_;
    bool sorting_ = false;
    std::atomic<bool> sorted_{false};
    std::vector<Row> table_;  ///< read once sorted_
    std::uint64_t sent_ = 0;
};

/// Maximum rays of visible_pixels: all may hit the same path, whose count is sent as u32.
constexpr std::uint64_t visible_rays_max = ~std::uint32_t{0};

tl::unexpected<protocol::Error> refuse_use(std::string_view reduce, const char* why) {
    return refuse(Code::invalid_field, "reduce " + std::string(reduce) + " " + why);
}

// A function for each row of the list; `reduce` is its name.

Reply<std::unique_ptr<QueryJob>> make_hit_fraction(const Services& services, const Caller& caller,
                                                   Plan plan, RaySource source,
                                                   std::string_view reduce) {
    if (!source.has_points()) return refuse_use(reduce, "is per point; use generator hemisphere");
    if (plan.csr()) return refuse_use(reduce, "counts rays, not hits; use kind any");
    return std::make_unique<FractionJob>(services, caller, std::move(plan), std::move(source));
}

Reply<std::unique_ptr<QueryJob>> make_visible_pixels(const Services& services, const Caller& caller,
                                                     Plan plan, RaySource source,
                                                     std::string_view reduce) {
    if (plan.query != query_closest)
        return refuse_use(reduce, "asks what is seen first; use kind closest");
    if (source.rays() > visible_rays_max)
        return refuse(Code::limit_exceeded,
                      "reduce visible_pixels counts at most " + std::to_string(visible_rays_max) +
                          " rays, these are " + std::to_string(source.rays()) +
                          "; ask for fewer samples or points");
    const SceneView& scene = plan.scene.snapshot().view();
    const std::uint64_t paths = std::min(source.rays(), scene.objects[scene.root].placement_count);
    const std::uint64_t bytes = paths * VisibleJob::path_bytes;
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (!lease)
        return services.budget.refuse("a table of " + std::to_string(paths) + " instance paths",
                                      bytes, caller.principal, "ask for fewer rays");
    return std::make_unique<VisibleJob>(services, caller, std::move(plan), std::move(source), paths,
                                        std::move(*lease));
}

}  // namespace

Reply<std::unique_ptr<QueryJob>> reduce_job(const Services& services, const Caller& caller,
                                            Plan plan, RaySource source, std::string_view reduce) {
    if (plan.untraced)
        return refuse_use(reduce, "needs rays that are traced; kind null traces none");
#define RAYNEST_REDUCER(name, ...) \
    if (reduce == #name)           \
        return make_##name(services, caller, std::move(plan), std::move(source), reduce);
#include "protocol/lists/reducers.def"
    return refuse(Code::internal, "reduce " + std::string(reduce) + " is in no list");
}

}  // namespace raynest::server

#include "server/handlers/reduce.h"

#include "server/handlers/query_job.h"

#include <algorithm>
#include <atomic>
#include <map>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Of a piece whose first ray this is.
Tally::Counts count_hits(const TraceBuffers& buffers, std::uint64_t first_ray) {
    Tally::Counts counts;
    counts.rays = buffers.hits.size();
    counts.add_rays(buffers.hits, buffers.order, first_ray);
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

/// The share of each point's rays that hit something. A task takes whole points, or a part of one
/// that has more rays than a task should trace; the last of its parts to end answers for it.
class FractionJob final : public QueryJob {
public:
    FractionJob(const Services& services, const Caller& caller, Plan plan, RaySource source)
        : QueryJob(services, caller, std::move(plan), std::move(source)),
          batch_rays_(plan_.chunk_rays_max(services.limits)),
          cuda_batch_rays_(plan_.cuda_rays_max(services.limits)),
          points_max_((frame_bytes_max(caller) - protocol::alignment) / sizeof(float)) {}

protected:
    [[nodiscard]] std::uint64_t piece_rays(const Piece& rest) const override {
        const std::uint64_t each = source_.rays_per_point();
        const std::uint64_t batch = on_cuda(rest) ? cuda_batch_rays_ : batch_rays_;
        return each > batch ? std::min(batch, each - rest.first % each) : each * task_points(batch);
    }
    [[nodiscard]] std::uint64_t reply_bytes(std::uint64_t rays) const override {
        const std::uint64_t points = std::max<std::uint64_t>(1, rays / source_.rays_per_point());
        return protocol::padded(points * sizeof(float));
    }
    [[nodiscard]] std::uint64_t rows() const override {
        return source_.rays() / source_.rays_per_point();
    }
    [[nodiscard]] std::uint64_t result_bytes() const override {
        return reply_bytes(source_.rays()) + (rows() / task_points(batch_rays_) + 1) *
                                                 (protocol::alignment + answer_head_bytes_max);
    }

    Reply<Frames> answer(const Piece& piece, const Stop& stop) override {
        TraceBuffers& buffers = TraceBuffers::of_this_thread();
        if (const auto traced = source_.trace(plan_, piece, stop, buffers, false); !traced)
            return tl::unexpected(traced.error());
        const std::uint64_t each = source_.rays_per_point();
        std::vector<std::uint32_t> hits(std::max<std::uint64_t>(1, piece.count / each));
        for (std::uint64_t i = 0; i < piece.count; ++i) hits[i / each] += buffers.hits[i].hit;
        const bool whole = piece.count >= each || add_part(piece, hits.front());
        auto frames = whole ? fractions(piece.first / each, hits) : Reply<Frames>(Frames{});
        if (!frames) return frames;
        tally_.add(buffers, count_hits(buffers, piece.first));
        services_.metrics.rays += piece.count;
        return frames;
    }

private:
    /// Whole points of a task; one that has more rays goes in parts.
    [[nodiscard]] std::uint64_t task_points(std::uint64_t batch) const {
        return std::clamp<std::uint64_t>(batch / source_.rays_per_point(), 1, points_max_);
    }
    /// Was it the last part of its point? Then `hits` become those of all.
    bool add_part(const Piece& piece, std::uint32_t& hits) {
        const std::uint64_t each = source_.rays_per_point();
        const std::lock_guard lock(mutex_);
        const auto part = parts_.try_emplace(piece.first / each).first;
        part->second.rays += piece.count;
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

    struct Part {
        std::uint64_t rays = 0;
        std::uint32_t hits = 0;
    };
    const std::uint64_t batch_rays_;
    const std::uint64_t cuda_batch_rays_;
    const std::uint64_t points_max_;  ///< of an answer
    std::mutex mutex_;
    std::map<std::uint64_t, Part> parts_;  ///< of points that are traced in parts, so far
};

/// How many rays see each instance path first. The counts of all tasks are added up; the table is
/// sorted when the last one has ended, and leaves in frames of its rows.
class VisibleJob final : public QueryJob {
public:
    VisibleJob(const Services& services, const Caller& caller, Plan plan, RaySource source,
               std::uint64_t paths_max, Budget::Lease lease)
        : QueryJob(services, caller, std::move(plan), std::move(source)),
          chunk_rays_(source_.chunk_rays(plan_.chunk_rays_max(services.limits))),
          cuda_rays_(source_.chunk_rays(plan_.cuda_rays_max(services.limits))),
          frame_rows_(std::min(services.limits.chunk_rays_max,
                               (frame_bytes_max(caller) - 2 * protocol::alignment) / row_bytes)),
          paths_max_(paths_max),
          lease_(std::move(lease)) {}

    /// Bytes held per path: an entry of the map and a row of the table.
    static constexpr std::uint64_t path_bytes = 80;

    std::optional<Task> next() override {
        if (auto task = QueryJob::next()) return task;
        if (!all_answered()) return std::nullopt;
        if (!sorted_) return sorting_ ? std::nullopt : std::optional(sort_task());
        if (sent_ == table_.size()) return std::nullopt;
        return rows_task();
    }
    [[nodiscard]] bool finished() const override { return sorted_ && sent_ == table_.size(); }
    [[nodiscard]] std::uint64_t held_bytes() const override { return lease_.bytes(); }

protected:
    [[nodiscard]] std::uint64_t piece_rays(const Piece& rest) const override {
        return on_cuda(rest) ? cuda_rays_ : chunk_rays_;
    }
    [[nodiscard]] std::uint64_t reply_bytes(std::uint64_t /*rays*/) const override { return 0; }
    [[nodiscard]] std::uint64_t rows() const override { return table_.size(); }
    [[nodiscard]] std::uint64_t result_bytes() const override {
        const std::uint64_t frames = paths_max_ / frame_rows_ + 1;
        return paths_max_ * row_bytes + frames * (2 * protocol::alignment + answer_head_bytes_max);
    }

    Reply<Frames> answer(const Piece& piece, const Stop& stop) override {
        TraceBuffers& buffers = TraceBuffers::of_this_thread();
        if (const auto traced = source_.trace(plan_, piece, stop, buffers, true); !traced)
            return tl::unexpected(traced.error());
        std::unordered_map<std::uint64_t, std::uint32_t> counts;
        for (const HitRecord& hit : buffers.hits)
            if (hit.hit != 0) ++counts[hit.path];
        {
            const std::lock_guard lock(mutex_);
            for (const auto& [path, count] : counts) counts_[path] += count;
        }
        tally_.add(buffers, count_hits(buffers, piece.first));
        services_.metrics.rays += piece.count;
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

    const std::uint64_t chunk_rays_;
    const std::uint64_t cuda_rays_;
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

constexpr std::string_view fraction_name = "hit_fraction";
constexpr std::string_view visible_name = "visible_pixels";
/// One path may be met by all of them, and its count travels as u32.
constexpr std::uint64_t visible_rays_max = ~std::uint32_t{0};

tl::unexpected<protocol::Error> refuse_use(std::string_view reduce, const char* why) {
    return refuse(Code::invalid_field, "reduce " + std::string(reduce) + " " + why);
}

}  // namespace

std::string_view default_kind(std::string_view reduce) {
    return reduce == fraction_name ? "any" : "closest";
}

Reply<std::unique_ptr<QueryJob>> reduce_job(const Services& services, const Caller& caller,
                                            Plan plan, RaySource source,
                                            const protocol::Opened<wire::Query>& message) {
    const std::string_view reduce = protocol::text(message->reduce());
    if (reduce != fraction_name && reduce != visible_name)
        return refuse(Code::invalid_field, "unknown reduce '" + std::string(reduce) +
                                               "': use one of " + std::string(fraction_name) +
                                               ", " + std::string(visible_name));
    if (message->fields() != nullptr && message->fields()->size() != 0)
        return refuse_use(reduce, "has columns of its own; name no fields");
    if (plan.untraced)
        return refuse_use(reduce, "needs rays that are traced; kind null traces none");
    if (reduce == fraction_name) {
        if (!source.has_points())
            return refuse_use(reduce, "is per point; use generator hemisphere");
        if (plan.csr()) return refuse_use(reduce, "counts rays, not hits; use kind any");
        return std::make_unique<FractionJob>(services, caller, std::move(plan), std::move(source));
    }
    if (plan.query != query_closest)
        return refuse_use(reduce, "asks what is seen first; use kind closest");
    if (source.rays() > visible_rays_max)
        return refuse(Code::limit_exceeded,
                      "reduce visible_pixels counts at most " + std::to_string(visible_rays_max) +
                          " rays, these are " + std::to_string(source.rays()) +
                          "; ask for fewer samples or points");
    const SceneView& scene = plan.scene.snapshot().view();
    const std::uint64_t paths = std::min(source.rays(), scene.objects[scene.root].leaves);
    services.peers.make_memory(paths * VisibleJob::path_bytes, caller.principal);
    auto lease = services.budget.reserve(paths * VisibleJob::path_bytes);
    if (!lease)
        return refuse(Code::resource_exhausted,
                      "a table of " + std::to_string(paths) +
                          " instance paths needs more memory than --memory has left; ask for "
                          "fewer rays");
    return std::make_unique<VisibleJob>(services, caller, std::move(plan), std::move(source), paths,
                                        std::move(*lease));
}

}  // namespace raynest::server

#include "server/jobs/columns_job.h"

#include "server/documents/step_rows.h"
#include "server/execution/trace.h"
#include "server/jobs/services.h"

#include <algorithm>
#include <atomic>
#include <numeric>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Returns the maximum bytes of a task's answer. For kind all it is an eighth of the window, so
/// that several tasks run at once, but at least the bytes of one ray.
std::uint64_t answer_bytes(const Plan& plan, const Columns::Cost& cost, const Caller& caller) {
    const std::uint64_t most = frame_bytes_max(caller);
    if (plan.query != query_all) return most;
    return std::clamp(caller.window_bytes / 8, cost.bytes(1, plan.hits_max), most);
}

/// Rays per frame, at most, in the estimate of how many frames a detached query's answer has.
constexpr std::uint64_t kept_rays_min = 1024;

/// Returns the maximum rays per answer frame.
std::uint64_t chunk_rays(const Plan& plan, const Columns::Cost& cost, std::uint64_t bytes,
                         const protocol::Limits& limits) {
    std::uint64_t most = limits.chunk_rays_max;
    for (const Backend* backend : plan.backends.order)
        most = std::min(most, backend->call_rays_max(plan));
    if (plan.query == query_all) return most;
    const std::uint64_t per_ray = cost.per_ray + cost.per_hit * plan.hits_max;
    const std::uint64_t by_reply = (bytes - cost.fixed) / std::max<std::uint64_t>(1, per_ray);
    return std::clamp<std::uint64_t>(by_reply, 1, most);
}

/// Shares the rays of a small query that the daemon makes out to several threads: its answer comes
/// sooner than that of one whole chunk.
std::uint64_t shared_out(const RaySource& source, std::uint64_t most) {
    constexpr std::uint64_t shares = 4;
    constexpr std::uint64_t least = 4096;
    constexpr std::uint64_t packet = 64;
    if (source.sent() != 0) return most;
    const std::uint64_t share = (source.rays() / shares + packet) / packet * packet;
    return std::min(most, std::max(least, share));
}

/// Returns the number of hit records of a task: as many as fit its answer, but at least two rays'.
std::uint64_t hits_room(const Plan& plan, const Columns::Cost& cost, std::uint64_t bytes) {
    const std::uint64_t most = hit_bytes_max / sizeof(HitRecord);
    const std::uint64_t fit = cost.per_hit == 0 ? most : (bytes - cost.fixed) / cost.per_hit;
    return std::clamp(fit, std::uint64_t{2} * plan.hits_max, most);
}

/// Hits per ray for which a detached query of kind all reserves memory at its start; more is
/// reserved as the answer grows.
constexpr std::uint64_t expected_hits = 8;

/// Maximum rays of a task that may be merged with others into one call of the kernel.
constexpr std::uint64_t merged_rays_max = 256;

/// A query that is answered with columns: a row per ray, or per hit.
class ColumnsJob final : public QueryJob {
public:
    ColumnsJob(const Services& services, const Caller& caller, Plan plan, RaySource source,
               Columns columns)
        : QueryJob(services, caller, std::move(plan), std::move(source)),
          columns_(std::move(columns)),
          cost_(columns_.cost(plan_)),
          answer_bytes_(answer_bytes(plan_, cost_, caller)),
          chunk_rays_(source_.chunk_rays(
              shared_out(source_, chunk_rays(plan_, cost_, answer_bytes_, services.limits)))),
          fitting_(chunk_rays_) {
        if (source_.motion())
            rows_.emplace(services.budget, principal_, id_, cost_,
                          StepRows::FrameSize{
                              services.limits.chunk_rays_max,
                              plan_.query == query_all ? answer_bytes_ : chunk_bytes(chunk_rays_)});
    }

    std::optional<Task> next() override {
        if (rows_ && steps().is_chosen())
            if (auto task = rows_->next(steps().order())) return task;
        return QueryJob::next();
    }
    Reply<void> ended() override {
        if (rows_) rows_->ended();
        return QueryJob::ended();
    }
    [[nodiscard]] bool finished() const override {
        return QueryJob::finished() && (!rows_ || rows_->handed_out() == source_.rays());
    }

protected:
    /// Returns the rays of several answers if the backend takes that many, as long as these answers
    /// together are within answer_bytes_.
    [[nodiscard]] std::uint64_t chunk_size(const Backend& backend,
                                           const Chunk& /*rest*/) const override {
        if (plan_.query == query_all) return fitting_;
        const std::uint64_t by_rays = backend.call_rays_max(plan_) / chunk_rays_;
        const std::uint64_t by_bytes = answer_bytes_ / chunk_bytes(chunk_rays_);
        return chunk_rays_ * std::max<std::uint64_t>(1, std::min(by_rays, by_bytes));
    }
    [[nodiscard]] std::uint64_t reply_bytes(std::uint64_t rays) const override {
        if (rows_) return 0;
        if (plan_.query == query_all) return answer_bytes_;
        const std::uint64_t rest = rays % chunk_rays_;
        return rays / chunk_rays_ * chunk_bytes(chunk_rays_) + (rest != 0 ? chunk_bytes(rest) : 0);
    }
    [[nodiscard]] std::uint64_t rows() const override { return source_.rays(); }

    [[nodiscard]] std::uint64_t result_bytes() const override {
        const std::uint64_t rays = source_.rays();
        const std::uint64_t hits = plan_.query == query_all
                                       ? std::min<std::uint64_t>(plan_.hits_max, expected_hits)
                                       : plan_.hits_max;
        return cost_.bytes(rays, rays * hits) + (rays / std::min(chunk_rays_, kept_rays_min) + 1) *
                                                    (cost_.fixed + answer_head_bytes_max);
    }

    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override {
        const auto plan = plan_of(chunk);
        auto traced = trace_rays_of(*plan, chunk, stop, buffers, any_order());
        if (!traced) return tl::unexpected(traced.error());
        const std::uint64_t count = fitting(*traced);
        Frames frames;
        for (std::uint64_t done = 0; done < count; done += chunk_rays_) {
            const std::uint64_t rays = std::min(chunk_rays_, count - done);
            auto frame = encode(*plan, chunk.first + done, traced->slice(done, rays));
            if (!frame) return tl::unexpected(TraceFailure(frame.error()));
            if (!rows_) {
                frames.push_back(std::move(*frame));
            } else if (auto kept = rows_->add(steps().order(), std::move(*frame)); !kept) {
                return tl::unexpected(TraceFailure(kept.error()));
            }
        }
        answered(chunk, count);
        if (plan_.query == query_all) give_back_behind(chunk, count);
        return frames;
    }

    [[nodiscard]] std::shared_ptr<const MergeableTask> mergeable(const Chunk& chunk) override {
        const bool small = chunk.count <= merged_rays_max && source_.sent() != 0;
        if (!small || source_.has_points() || input_.has_masks() || !any_order() ||
            !plan_.is_local() || plan_.traversal == traversal_reference)
            return nullptr;
        return std::make_shared<MergeableChunk>(*this, chunk);
    }

private:
    /// A chunk of a closest or any query with rays that the client sent.
    class MergeableChunk final : public MergeableTask {
    public:
        MergeableChunk(ColumnsJob& job, const Chunk& chunk) : job_(job), chunk_(chunk) {}
        [[nodiscard]] std::uint64_t rays() const override { return chunk_.count; }
        [[nodiscard]] bool same_as(const MergeableTask& other) const override {
            const auto* chunk = dynamic_cast<const MergeableChunk*>(&other);
            return chunk != nullptr && chunk_.backend == chunk->chunk_.backend &&
                   job_.plan_.same_call(chunk->job_.plan_);
        }
        [[nodiscard]] Reply<AnswerRows> trace(std::span<const MergeableTask* const> all,
                                              const Stop& stop) const override {
            const std::shared_ptr buffers = job_.services_.trace_buffers.take();
            std::uint64_t count = 0;
            for (const MergeableTask* each : all) count += each->rays();
            buffers->resize(buffers->rays, count);
            std::span<Ray> rest = buffers->rays;
            for (const MergeableTask* each : all) {
                const auto& merged = static_cast<const MergeableChunk&>(*each);
                const Chunk& chunk = merged.chunk_;
                merged.job_.statistics_.begin();
                std::ranges::copy(merged.job_.input_.sent(chunk.first, chunk.count, *buffers),
                                  rest.begin());
                rest = rest.subspan(chunk.count);
            }
            auto traced = trace_rays(job_.plan_, chunk_.backend, buffers->rays, stop, *buffers);
            if (!traced) return refuse(Code::busy, "");  // each then runs alone and gets its reason
            return [buffers, traced = *traced](const MergeableTask& of, std::uint64_t first_row) {
                const auto& merged = static_cast<const MergeableChunk&>(of);
                return merged.job_.answer_rows(merged.chunk_, traced.slice(first_row, of.rays()));
            };
        }

    private:
        ColumnsJob& job_;
        const Chunk chunk_;
    };

    Reply<Frames> answer_rows(const Chunk& chunk, const TracedRays& traced) {
        auto frame = encode(plan_, chunk.first, traced);
        if (!frame) return tl::unexpected(frame.error());
        answered(chunk, chunk.count);
        Frames frames;
        frames.push_back(std::move(*frame));
        return frames;
    }

    [[nodiscard]] std::uint64_t chunk_bytes(std::uint64_t rays) const {
        return cost_.bytes(rays, rays * plan_.hits_max);
    }

    /// Encodes the frame with the columns of these rays. Any thread.
    Reply<protocol::Frame> encode(const Plan& plan, std::uint64_t first, const TracedRays& traced) {
        return columns_.encode(plan, services_.registry, id_, first, traced, statistics_,
                               sensors(first, traced.rows()));
    }

    /// The sensor at each of these rays; nothing if there is none, or no column needs it.
    [[nodiscard]] std::vector<SensorAt> sensors(std::uint64_t first, std::size_t count) const {
        std::vector<SensorAt> made;
        if (!source_.has_sensor() || !(columns_.read_motion() || columns_.read_sensor()))
            return made;
        std::vector<std::uint64_t> numbers(count);
        if (rows_)
            steps().order().numbers(first, numbers);
        else
            std::iota(numbers.begin(), numbers.end(), source_.first() + first);
        made.reserve(count);
        for (const std::uint64_t number : numbers) made.push_back(source_.sensor_at(number));
        return made;
    }

    /// True if rays may be traced in any order and among others, because each has one hit record
    /// and nothing else.
    [[nodiscard]] bool any_order() const {
        return !plan_.csr() && plan_.counters == counters_none && !plan_.untraced &&
               plan_.variant->outputs().empty();
    }

    /// Returns how many of the traced rays fit the promised answer; at least one does.
    [[nodiscard]] std::uint64_t fitting(const TracedRays& traced) const {
        if (plan_.query != query_all) return traced.rays.size();
        std::uint64_t hits = 0;
        std::uint64_t rays = 0;
        while (rays < traced.rays.size() &&
               cost_.bytes(rays + 1, hits + traced.counts[rays]) <= answer_bytes_)
            hits += traced.counts[rays++];
        return rays;
    }

    /// Returns the rays after the first `count`, which fitted the answer, to the queue, and adapts
    /// fitting_.
    void give_back_behind(Chunk chunk, std::uint64_t count) {
        chunk.split(count);
        if (chunk.count != 0) {
            fitting_ = count;
            queue_.give_back(chunk);
        } else {
            fitting_ = std::max(fitting_.load(), std::min(2 * count, chunk_rays_));
        }
    }

    const Columns columns_;
    const Columns::Cost cost_;
    const std::uint64_t answer_bytes_;
    const std::uint64_t chunk_rays_;      ///< maximum rays per answer
    std::atomic<std::uint64_t> fitting_;  ///< kind all: rays of the next task
    std::optional<StepRows> rows_;        ///< set for a scene that moves meanwhile
};

/// Fails if the answer of one ray does not fit a frame that the client can receive.
Reply<void> check_frame_bytes(const Plan& plan, const Columns::Cost& cost, const Caller& caller) {
    const std::uint64_t bytes = cost.bytes(1, plan.hits_max);
    const std::uint64_t most = frame_bytes_max(caller);
    if (bytes <= most) return {};
    const bool in_a_window = bytes <= answer_frame_bytes_max;
    std::string message =
        std::to_string(plan.hits_max) + " hits of one ray are " + std::to_string(bytes) +
        " bytes of columns, over " + std::to_string(in_a_window ? most : answer_frame_bytes_max) +
        (in_a_window ? ", half of the window" : ", the most that one answer brings") +
        "; ask for fewer hits or columns";
    if (in_a_window) message += ", or grant window_bytes = " + std::to_string(2 * bytes);
    return refuse(Code::limit_exceeded, std::move(message));
}

}  // namespace

Reply<std::unique_ptr<QueryJob>> columns_job(const Services& services, const Caller& caller,
                                             Plan plan, RaySource source, Columns columns) {
    if (const auto known = columns.check_outputs(*plan.variant); !known)
        return tl::unexpected(known.error());
    if (columns.read_sensor() && !source.has_sensor())
        return refuse(Code::invalid_field,
                      "the column sensor_position is of rays that a generator with a sensor makes: "
                      "the daemon does not know where the sensor of these stands");
    const Columns::Cost cost = columns.cost(plan);
    if (const auto fits = check_frame_bytes(plan, cost, caller); !fits)
        return tl::unexpected(fits.error());
    plan.hits_room = hits_room(plan, cost, answer_bytes(plan, cost, caller));
    return std::make_unique<ColumnsJob>(services, caller, std::move(plan), std::move(source),
                                        std::move(columns));
}

}  // namespace raynest::server

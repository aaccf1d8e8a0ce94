// QUERY: rays come in QUERY_RAYS frames and are traced as they come; answers leave as CHUNKs.
#include "server/handlers/columns.h"
#include "server/handlers/handler.h"
#include "server/handlers/tracing.h"

#include <algorithm>
#include <deque>
#include <memory>
#include <utility>

namespace raynest::server {
namespace {

/// A chunk's answer is built in cache-sized pieces: larger ones cost 1.5 times as much to send.
constexpr std::uint64_t reply_bytes_max = 4ULL << 20;

/// Room for the answers of a detached query is reserved for chunks of so many rays at least.
constexpr std::uint64_t kept_rays_min = 1024;
/// Header and control message of a chunk: a name and a description for each of at most 64 blocks.
constexpr std::uint64_t chunk_head_bytes_max = 8ULL << 10;

/// Rays per task, so that an answer never exceeds half of the client's window.
std::uint64_t chunk_rays(const Plan& plan, const Columns::Cost& cost, const Caller& caller,
                         const protocol::Limits& limits) {
    const std::uint64_t bytes = std::min(reply_bytes_max, caller.window_bytes / 2) - cost.fixed;
    const std::uint64_t by_reply = bytes / std::max<std::uint64_t>(1, cost.per_ray);
    const std::uint64_t by_hits = hit_bytes_max / (sizeof(HitRecord) * plan.hits_max);
    const std::uint64_t most = std::min({by_reply, by_hits, plan.chunk_rays_max(limits)});
    return std::max<std::uint64_t>(1, most);
}

class QueryJob final : public Job {
public:
    QueryJob(const Services& services, const Caller& caller, Plan plan, Columns columns,
             std::uint64_t ray_count)
        : services_(services),
          id_(caller.request_id),
          plan_(std::move(plan)),
          columns_(std::move(columns)),
          cost_(columns_.cost(plan_)),
          chunk_rays_(chunk_rays(plan_, cost_, caller, services.limits)),
          ray_count_(ray_count) {}

    Frames greeting() override {
        Frames frames;
        frames.push_back(*protocol::encode(id_, started(plan_, services_.limits)));
        return frames;
    }

    Reply<std::uint64_t> feed(protocol::Frame frame) override {
        const auto message = protocol::open<wire::QueryRays>(frame, services_.limits);
        if (!message) return tl::unexpected(message.error());
        const auto block =
            protocol::only_block(message->blocks, "rays", wire::Dtype::f32, sizeof(Ray));
        if (!block) return tl::unexpected(block.error());
        if ((*message)->first_ray() != received_)
            return refuse(Code::invalid_field,
                          "first_ray is " + std::to_string((*message)->first_ray()) +
                              ", the rays so far are " + std::to_string(received_));
        if (block->count == 0 || block->count > services_.limits.chunk_rays_max ||
            block->count > ray_count_ - received_)
            return refuse(Code::invalid_field, "a frame of " + std::to_string(block->count) +
                                                   " rays; " +
                                                   std::to_string(ray_count_ - received_) +
                                                   " are still to come, and a frame holds 1.." +
                                                   std::to_string(services_.limits.chunk_rays_max));
        const std::span<const Ray> rays{reinterpret_cast<const Ray*>(block->bytes.data()),
                                        static_cast<std::size_t>(block->count)};
        pieces_.push_back({std::make_shared<const protocol::Frame>(std::move(frame)), rays});
        received_ += rays.size();
        return std::uint64_t{0};
    }

    std::optional<Task> next() override {
        if (pieces_.empty()) return std::nullopt;
        Piece& piece = pieces_.front();
        const std::size_t count = std::min<std::size_t>(chunk_rays_, piece.rays.size());
        const std::span<const Ray> rays = piece.rays.first(count);
        piece.rays = piece.rays.subspan(count);

        Task task;
        task.reply_bytes_max = cost_.fixed + cost_.per_ray * count;
        if (brief_) task.brief_hits = count * plan_.hits_max;
        task.run = [this, frame = piece.frame, rays, first = dispatched_](const StopFlag&) {
            return answer(rays, first);
        };
        dispatched_ += count;
        if (piece.rays.empty()) {
            task.input_bytes = piece.frame->header.bulk_bytes;
            pieces_.pop_front();
        }
        return task;
    }

    [[nodiscard]] bool needs_input() const override { return received_ < ray_count_; }
    [[nodiscard]] bool finished() const override { return dispatched_ == ray_count_; }

    /// Bytes of all chunks, headers included, when rays come in frames of at least kept_rays_min.
    [[nodiscard]] std::uint64_t result_bytes_max() const {
        const std::uint64_t chunks = ray_count_ / std::min(chunk_rays_, kept_rays_min) + 1;
        return ray_count_ * cost_.per_ray + chunks * (cost_.fixed + chunk_head_bytes_max);
    }

    Frames farewell() override {
        Frames frames;
        frames.push_back(*protocol::encode(id_, tally_.done()));
        return frames;
    }

    [[nodiscard]] std::optional<Progress> progress() const override {
        return Progress{tally_.rays(), ray_count_, "tracing"};
    }

private:
    /// Rays of one frame that no task has taken yet; they lie in the frame.
    struct Piece {
        std::shared_ptr<const protocol::Frame> frame;
        std::span<const Ray> rays;
    };

    Reply<Frames> answer(std::span<const Ray> rays, std::uint64_t first) {
        tally_.begin();
        TraceBuffers& buffers = TraceBuffers::of_this_thread();
        if (const auto traced = trace(plan_, rays, buffers); !traced)
            return tl::unexpected(traced.error());
        auto frame = columns_.encode(plan_, services_.registry, id_, first, rays, buffers, tally_);
        if (!frame) return tl::unexpected(frame.error());
        services_.metrics.rays += rays.size();
        Frames frames;
        frames.push_back(std::move(*frame));
        return frames;
    }

    const Services& services_;
    const std::uint64_t id_;
    const Plan plan_;
    const Columns columns_;
    const Columns::Cost cost_;
    const std::uint64_t chunk_rays_;
    const std::uint64_t ray_count_;
    const bool brief_ =
        ray_count_ * plan_.hits_max <= brief_hits_max && plan_.traversal != traversal_reference;
    Tally tally_;
    std::deque<Piece> pieces_;
    std::uint64_t received_ = 0;
    std::uint64_t dispatched_ = 0;
};

}  // namespace

Reply<Answer> query(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Query>& message) {
    const auto kind = parse_query(protocol::word(message->kind(), "closest"));
    if (!kind) return refuse(Code::invalid_field, kind.error().message);
    auto columns = Columns::choose(protocol::strings(message->fields()), *kind);
    if (!columns) return tl::unexpected(columns.error());
    auto plan = make_plan(services, *message->job(), *kind, columns->counting());
    if (!plan) return tl::unexpected(plan.error());
    if (const auto known = columns->check_outputs(*plan->variant); !known)
        return tl::unexpected(known.error());
    if (*kind == query_multi) plan->hits_max = message->max_hits();

    Accepted accepted = accept(*plan, "query", message->ray_count());
    accepted.detail = protocol::word(message->kind(), "closest");
    // At worst every ray comes in a frame of its own.
    accepted.input_bytes = protocol::alignment * message->ray_count();
    auto job = std::make_unique<QueryJob>(services, caller, std::move(*plan), std::move(*columns),
                                          message->ray_count());
    accepted.result_bytes_max = job->result_bytes_max();
    accepted.job = std::move(job);
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server

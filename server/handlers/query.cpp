// QUERY: rays come in QUERY_RAYS frames and are traced as they come; answers leave as CHUNKs.
//
// How many hits the rays of kind `all` have is known only once they are traced. A task promises a
// frame of bounded size, answers as many of its rays as fit, and gives the others back; how many
// fitted is how many the next task gets.
#include "server/handlers/columns.h"
#include "server/handlers/handler.h"
#include "server/handlers/tracing.h"

#include <algorithm>
#include <atomic>
#include <deque>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// A chunk's answer is built in cache-sized pieces: larger ones cost 1.5 times as much to send.
constexpr std::uint64_t reply_bytes_max = 4ULL << 20;

/// No answer may be larger, so that half of the client's window is enough for it.
std::uint64_t frame_bytes_max(const Caller& caller) {
    return std::min(reply_bytes_max, caller.window_bytes / 2);
}

/// Bytes that a task promises not to exceed. Where hits are not known in advance, an eighth of the
/// window, so that several tasks run at a time; but room for one ray at least.
std::uint64_t answer_bytes(const Plan& plan, const Columns::Cost& cost, const Caller& caller) {
    const std::uint64_t most = frame_bytes_max(caller);
    if (plan.query != query_all) return most;
    return std::clamp(caller.window_bytes / 8, cost.bytes(1, plan.hits_max), most);
}

/// Rays per task.
std::uint64_t chunk_rays(const Plan& plan, const Columns::Cost& cost, std::uint64_t bytes,
                         const protocol::Limits& limits) {
    if (plan.query == query_all) return plan.chunk_rays_max(limits);
    const std::uint64_t per_ray = cost.per_ray + cost.per_hit * plan.hits_max;
    const std::uint64_t by_reply = (bytes - cost.fixed) / std::max<std::uint64_t>(1, per_ray);
    const std::uint64_t by_hits = hit_bytes_max / (sizeof(HitRecord) * plan.hits_max);
    const std::uint64_t most = std::min({by_reply, by_hits, plan.chunk_rays_max(limits)});
    return std::max<std::uint64_t>(1, most);
}

/// Records that a task has room for: what fits its answer, at least what any ray needs.
std::uint64_t hits_room(const Plan& plan, const Columns::Cost& cost, std::uint64_t bytes) {
    const std::uint64_t most = hit_bytes_max / sizeof(HitRecord);
    const std::uint64_t fit = cost.per_hit == 0 ? most : (bytes - cost.fixed) / cost.per_hit;
    return std::clamp(fit, std::uint64_t{2} * plan.hits_max, most);
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
          answer_bytes_(answer_bytes(plan_, cost_, caller)),
          chunk_rays_(chunk_rays(plan_, cost_, answer_bytes_, services.limits)),
          ray_count_(ray_count),
          fitting_(chunk_rays_) {
        plan_.hits_room = hits_room(plan_, cost_, answer_bytes_);
    }

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
        const std::uint64_t bytes = frame.header.bulk_bytes;
        pieces_.push_back(
            {std::make_shared<const protocol::Frame>(std::move(frame)), rays, received_, bytes});
        received_ += rays.size();
        return std::uint64_t{0};
    }

    std::optional<Task> next() override {
        take_back_unanswered();
        if (pieces_.empty()) return std::nullopt;
        Piece piece = pieces_.front();
        const std::size_t count = std::min<std::size_t>(fitting_, piece.rays.size());
        Task task;
        if (count < piece.rays.size()) {
            pieces_.front() = piece.behind(count);
            piece.rays = piece.rays.first(count);
        } else {
            task.input_bytes = piece.input_bytes;
            pieces_.pop_front();
        }
        task.reply_bytes_max = plan_.query == query_all
                                   ? answer_bytes_
                                   : cost_.bytes(count, std::uint64_t{count} * plan_.hits_max);
        task.run = [this, piece = std::move(piece)](const StopFlag&) { return answer(piece); };
        return task;
    }

    [[nodiscard]] bool finished() const override { return tally_.rays() == ray_count_; }

    Frames farewell() override {
        Frames frames;
        frames.push_back(*protocol::encode(id_, tally_.done()));
        return frames;
    }

    [[nodiscard]] std::optional<Progress> progress() const override {
        return Progress{tally_.rays(), ray_count_, "tracing"};
    }

private:
    /// Rays of one frame that have no answer yet; they lie in the frame.
    struct Piece {
        std::shared_ptr<const protocol::Frame> frame;
        std::span<const Ray> rays;
        std::uint64_t first = 0;        ///< of them in the query
        std::uint64_t input_bytes = 0;  ///< of the frame; given back with its last ray

        [[nodiscard]] Piece behind(std::size_t count) const {
            return {frame, rays.subspan(count), first + count, input_bytes};
        }
    };

    /// Worker thread.
    Reply<Frames> answer(const Piece& piece) {
        tally_.begin();
        TraceBuffers& buffers = TraceBuffers::of_this_thread();
        if (const auto traced = trace(plan_, piece.rays, buffers); !traced)
            return tl::unexpected(traced.error());
        const std::size_t count = fitting(buffers);
        auto frame = columns_.encode(plan_, services_.registry, id_, piece.first,
                                     piece.rays.first(count), buffers, tally_);
        if (!frame) return tl::unexpected(frame.error());
        if (plan_.query == query_all) give_back(piece, count);
        services_.metrics.rays += count;
        Frames frames;
        frames.push_back(std::move(*frame));
        return frames;
    }

    /// How many of the traced rays fit the promised answer; one always does.
    [[nodiscard]] std::size_t fitting(const TraceBuffers& buffers) const {
        if (plan_.query != query_all) return buffers.answered;
        std::uint64_t hits = 0;
        std::size_t rays = 0;
        while (rays < buffers.answered &&
               cost_.bytes(rays + 1, hits + buffers.counts[rays]) <= answer_bytes_)
            hits += buffers.counts[rays++];
        return rays;
    }

    /// Worker thread: `count` rays of the piece fitted an answer. Those behind go to another task;
    /// the bytes of their frame were counted with this one.
    void give_back(const Piece& piece, std::size_t count) {
        const bool all = count == piece.rays.size();
        fitting_ = all ? std::min<std::uint64_t>(2 * fitting_, chunk_rays_) : count;
        if (all) return;
        const std::lock_guard lock(mutex_);
        unanswered_.push_back(piece.behind(count));
        unanswered_.back().input_bytes = 0;
    }
    void take_back_unanswered() {
        const std::lock_guard lock(mutex_);
        pieces_.insert(pieces_.begin(), unanswered_.begin(), unanswered_.end());
        unanswered_.clear();
    }

    const Services& services_;
    const std::uint64_t id_;
    Plan plan_;
    const Columns columns_;
    const Columns::Cost cost_;
    const std::uint64_t answer_bytes_;
    const std::uint64_t chunk_rays_;
    const std::uint64_t ray_count_;
    Tally tally_;
    std::deque<Piece> pieces_;
    std::uint64_t received_ = 0;
    std::atomic<std::uint64_t> fitting_;  ///< rays to try with the next task
    std::mutex mutex_;
    std::vector<Piece> unanswered_;  ///< left over by tasks
};

/// Every answer must fit a frame that the client can take.
Reply<void> check_frame_bytes(const Plan& plan, const Columns& columns, const Caller& caller) {
    const std::uint64_t bytes = columns.cost(plan).bytes(1, plan.hits_max);
    const std::uint64_t most = frame_bytes_max(caller);
    if (bytes <= most) return {};
    return refuse(Code::limit_exceeded,
                  std::to_string(plan.hits_max) + " hits of one ray are " + std::to_string(bytes) +
                      " bytes of columns, over " + std::to_string(most) +
                      ", half of the window at most; ask for fewer hits or columns, or grant a "
                      "larger window_bytes");
}

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
    if (plan->csr()) plan->hits_max = message->max_hits();
    if (const auto fits = check_frame_bytes(*plan, *columns, caller); !fits)
        return tl::unexpected(fits.error());

    Accepted accepted;
    accepted.deadline_ms = plan->deadline_ms;
    accepted.priority = plan->priority;
    accepted.job = std::make_unique<QueryJob>(services, caller, std::move(*plan),
                                              std::move(*columns), message->ray_count());
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server

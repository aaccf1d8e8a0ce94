// QUERY: rays come in QUERY_RAYS frames, or are made here, and are traced as they come; answers
// leave as CHUNKs of columns, or are added up (reduce.h).
//
// How many hits the rays of kind `all` have is known only once they are traced. A task promises a
// frame of bounded size, answers as many of its rays as fit, and gives the others back; how many
// fitted is how many the next task gets.
#include "server/handlers/columns.h"
#include "server/handlers/handler.h"
#include "server/handlers/query_job.h"
#include "server/handlers/reduce.h"

#include <algorithm>
#include <atomic>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

/// Bytes that a task promises not to exceed. Where hits are not known in advance, an eighth of the
/// window, so that several tasks run at a time; but room for one ray at least.
std::uint64_t answer_bytes(const Plan& plan, const Columns::Cost& cost, const Caller& caller) {
    const std::uint64_t most = frame_bytes_max(caller);
    if (plan.query != query_all) return most;
    return std::clamp(caller.window_bytes / 8, cost.bytes(1, plan.hits_max), most);
}

/// Room for the answers of a detached query is reserved for chunks of so many rays at least.
constexpr std::uint64_t kept_rays_min = 1024;

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

/// Hits per ray where a request names no number.
constexpr std::uint32_t multi_hits = 8;
constexpr std::uint32_t all_hits = 4096;

/// Room for a detached query's answer of any number of hits is reserved for so many per ray, more
/// as it comes.
constexpr std::uint64_t expected_hits = 8;

/// A task of so few rays may share its call of the kernel with others.
constexpr std::uint64_t question_rays_max = 256;

/// A row per ray, or one per hit.
class ColumnsJob final : public QueryJob {
public:
    ColumnsJob(const Services& services, const Caller& caller, Plan plan, RaySource source,
               Columns columns)
        : QueryJob(services, caller, std::move(plan), std::move(source)),
          columns_(std::move(columns)),
          cost_(columns_.cost(plan_)),
          answer_bytes_(answer_bytes(plan_, cost_, caller)),
          chunk_rays_(source_.chunk_rays(chunk_rays(plan_, cost_, answer_bytes_, services.limits))),
          cuda_rays_(cuda_chunks() * chunk_rays_),
          fitting_(chunk_rays_) {}

protected:
    [[nodiscard]] std::uint64_t piece_rays(const Piece& rest) const override {
        return on_cuda(rest) ? cuda_rays_ : fitting_.load();
    }
    [[nodiscard]] std::uint64_t reply_bytes(std::uint64_t rays) const override {
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

    Reply<Frames> answer(const Piece& piece, const Stop& stop) override {
        TraceBuffers& buffers = TraceBuffers::of_this_thread();
        auto rays = source_.trace(plan_, piece, stop, buffers, any_order());
        if (!rays) return tl::unexpected(rays.error());
        if (piece.count > chunk_rays_) return encode_in_chunks(piece.first, *rays, buffers);
        const std::size_t count = fitting(buffers);
        auto frames = encode(piece.first, rays->first(count), buffers);
        if (frames && plan_.query == query_all) give_back_behind(piece, count);
        return frames;
    }

    [[nodiscard]] std::shared_ptr<const Question> question(const Piece& piece) override {
        const bool small = piece.count <= question_rays_max && !piece.sent.empty();
        if (!small || source_.has_points() || !any_order() || plan_.worker.cuda != nullptr ||
            plan_.traversal == traversal_reference)
            return nullptr;
        return std::make_shared<RaysQuestion>(*this, piece);
    }

private:
    /// A closest or any query of rays that the client sent.
    class RaysQuestion final : public Question {
    public:
        RaysQuestion(ColumnsJob& job, Piece piece) : job_(job), piece_(std::move(piece)) {}
        [[nodiscard]] std::uint64_t rays() const override { return piece_.count; }
        [[nodiscard]] bool same_as(const Question& other) const override {
            const auto* question = dynamic_cast<const RaysQuestion*>(&other);
            return question != nullptr && job_.plan_.same_call(question->job_.plan_);
        }
        [[nodiscard]] Reply<void> trace(std::span<const Question* const> all,
                                        const Stop& stop) const override {
            TraceBuffers& buffers = TraceBuffers::of_this_thread();
            buffers.rays.clear();
            for (const Question* each : all) {
                const auto& question = static_cast<const RaysQuestion&>(*each);
                question.job_.tally_.begin();
                const Piece& piece = question.piece_;
                const auto rays =
                    piece.sent.rays(piece.first - piece.sent_first, piece.count, buffers.sent);
                buffers.rays.insert(buffers.rays.end(), rays.begin(), rays.end());
            }
            return server::trace(job_.plan_, buffers.rays, stop, buffers);
        }
        [[nodiscard]] Reply<Frames> answer(std::uint64_t first_row) const override {
            TraceBuffers& traced = TraceBuffers::of_this_thread();
            const auto first = traced.hits.begin() + static_cast<std::ptrdiff_t>(first_row);
            TraceBuffers own;
            own.traversal = traced.traversal;
            own.hits.assign(first, first + static_cast<std::ptrdiff_t>(piece_.count));
            const std::span<const Ray> rays(traced.rays);
            return job_.encode(piece_.first, rays.subspan(first_row, piece_.count), own);
        }

    private:
        ColumnsJob& job_;
        const Piece piece_;
    };

    [[nodiscard]] std::uint64_t chunk_bytes(std::uint64_t rays) const {
        return cost_.bytes(rays, rays * plan_.hits_max);
    }

    /// A GPU's call is answered in frames as a CPU's are, which together are no more than one
    /// answer may be: how many.
    [[nodiscard]] std::uint64_t cuda_chunks() const {
        const std::uint64_t by_rays = plan_.cuda_rays_max(services_.limits) / chunk_rays_;
        const std::uint64_t by_bytes = answer_bytes_ / chunk_bytes(chunk_rays_);
        return std::max<std::uint64_t>(1, std::min(by_rays, by_bytes));
    }

    Reply<Frames> encode_in_chunks(std::uint64_t first, std::span<const Ray> rays,
                                   TraceBuffers& buffers) {
        Frames frames;
        TraceBuffers chunk;
        for (std::uint64_t done = 0; done < rays.size(); done += chunk_rays_) {
            buffers.copy(done, std::min(chunk_rays_, rays.size() - done), rays, chunk);
            auto frame = encode(first + done, chunk.rays, chunk);
            if (!frame) return frame;
            frames.push_back(std::move(frame->front()));
        }
        return frames;
    }

    /// Worker thread: the frame with the columns of these rays.
    Reply<Frames> encode(std::uint64_t first, std::span<const Ray> rays, TraceBuffers& buffers) {
        auto frame = columns_.encode(plan_, services_.registry, id_, first, rays, buffers, tally_);
        if (!frame) return tl::unexpected(frame.error());
        services_.metrics.rays += rays.size();
        Frames frames;
        frames.push_back(std::move(*frame));
        return frames;
    }

    /// May rays be traced among others, in any order? Each then has one hit and nothing else.
    [[nodiscard]] bool any_order() const {
        return !plan_.csr() && !plan_.counting && !plan_.untraced &&
               plan_.variant->outputs().empty();
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

    /// `count` rays of the piece fitted an answer.
    void give_back_behind(Piece piece, std::uint64_t count) {
        free_input(piece, count);
        piece.split(count);
        if (piece.count != 0) {
            fitting_ = count;
            give_back(std::move(piece));
        } else {
            fitting_ = std::max(fitting_.load(), std::min(2 * count, chunk_rays_));
        }
    }

    const Columns columns_;
    const Columns::Cost cost_;
    const std::uint64_t answer_bytes_;
    const std::uint64_t chunk_rays_;
    const std::uint64_t cuda_rays_;       ///< of several chunks
    std::atomic<std::uint64_t> fitting_;  ///< rays to try with the next task
};

/// Every answer must fit a frame that the client can take.
Reply<void> check_frame_bytes(const Plan& plan, const Columns::Cost& cost, const Caller& caller) {
    const std::uint64_t bytes = cost.bytes(1, plan.hits_max);
    const std::uint64_t most = frame_bytes_max(caller);
    if (bytes <= most) return {};
    return refuse(Code::limit_exceeded,
                  std::to_string(plan.hits_max) + " hits of one ray are " + std::to_string(bytes) +
                      " bytes of columns, over " + std::to_string(most) +
                      ", half of the window at most; ask for fewer hits or columns, or grant a "
                      "larger window_bytes");
}

/// What is asked of each ray. Kind `null` asks nothing: the answers of a closest query that misses.
struct Kind {
    Query query = query_closest;
    bool untraced = false;
};

Reply<Kind> kind_of(std::string_view word) {
    if (word == "null") return Kind{query_closest, true};
    const auto query = parse_query(word);
    if (!query) return refuse(Code::invalid_field, query.error().message + ", null");
    return Kind{*query};
}

Reply<std::unique_ptr<QueryJob>> columns_job(const Services& services, const Caller& caller,
                                             Plan plan, RaySource source, Columns columns) {
    if (const auto known = columns.check_outputs(*plan.variant); !known)
        return tl::unexpected(known.error());
    const Columns::Cost cost = columns.cost(plan);
    if (const auto fits = check_frame_bytes(plan, cost, caller); !fits)
        return tl::unexpected(fits.error());
    plan.hits_room = hits_room(plan, cost, answer_bytes(plan, cost, caller));
    return std::make_unique<ColumnsJob>(services, caller, std::move(plan), std::move(source),
                                        std::move(columns));
}

}  // namespace

Reply<Answer> query(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Query>& message) {
    const std::string_view reduce = protocol::text(message->reduce());
    const auto kind = kind_of(protocol::word(message->kind(), default_kind(reduce)));
    if (!kind) return tl::unexpected(kind.error());
    auto columns = Columns::choose(protocol::strings(message->fields()), kind->query);
    if (!columns) return tl::unexpected(columns.error());
    auto plan = make_plan(services, caller, *message->job(), kind->query, columns->counting());
    if (!plan) return tl::unexpected(plan.error());
    plan->untraced = kind->untraced;
    plan->reads_rays = reduce.empty() && columns->read_rays();
    if (plan->csr()) plan->hits_max = message->max_hits();
    if (plan->hits_max == 0) plan->hits_max = kind->query == query_all ? all_hits : multi_hits;
    auto source = RaySource::make(*message.table, plan->scene.snapshot());
    if (!source) return tl::unexpected(source.error());
    if (source->rays() > services.limits.rays_max)
        return refuse(Code::limit_exceeded, "a query of " + std::to_string(source->rays()) +
                                                " rays, the limit is rays_max = " +
                                                std::to_string(services.limits.rays_max));
    if (auto chosen = choose_worker(services, source->rays(), *plan); !chosen)
        return tl::unexpected(chosen.error());

    Accepted accepted = accept(*plan, "query", source->rays());
    accepted.detail =
        reduce.empty() ? protocol::word(message->kind(), default_kind(reduce)) : reduce;
    // At worst every ray comes in a frame of its own.
    accepted.input_bytes = protocol::alignment * message->ray_count();
    auto job = reduce.empty()
                   ? columns_job(services, caller, std::move(*plan), std::move(*source),
                                 std::move(*columns))
                   : reduce_job(services, caller, std::move(*plan), std::move(*source), message);
    if (!job) return tl::unexpected(job.error());
    accepted.result_bytes = (*job)->result_bytes();
    accepted.answer_bytes =
        kind->query == query_all ? services.limits.window_bytes : accepted.result_bytes;
    accepted.job = std::move(*job);
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server

#include "server/handlers/query_job.h"

#include "protocol/control.h"

#include <algorithm>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint64_t reply_bytes_max = 4ULL << 20;

/// What a frame of rays that waits costs beside its bulk part, which its credit pays for: mostly
/// more than 64 bytes, the least bulk.
constexpr std::uint64_t sent_frame_bytes = 512;

}  // namespace

std::uint64_t frame_bytes_max(const Caller& caller) {
    return std::min(reply_bytes_max, caller.window_bytes / 2);
}

QueryJob::QueryJob(const Services& services, const Caller& caller, Plan plan, RaySource source)
    : services_(services),
      id_(caller.request_id),
      plan_(std::move(plan)),
      source_(std::move(source)) {
    if (!source_.sends()) pieces_.push_back({0, source_.rays()});
}

Frames QueryJob::greeting() {
    wire::StartedT message = started(plan_, services_.limits);
    message.rays = source_.rays();
    Frames frames;
    frames.push_back(*protocol::encode(id_, message));
    return frames;
}

Reply<std::uint64_t> QueryJob::feed(protocol::Frame frame) {
    if (!source_.sends())
        return refuse(Code::invalid_field, "the daemon makes the rays of this query: send none");
    const auto message = protocol::open<wire::QueryRays>(frame, services_.limits);
    if (!message) return tl::unexpected(message.error());
    const auto sent = SentRays::of(*message);
    if (!sent) return tl::unexpected(sent.error());
    if ((*message)->first_ray() != received_)
        return refuse(Code::invalid_field,
                      "first_ray is " + std::to_string((*message)->first_ray()) +
                          ", the rays so far are " + std::to_string(received_));
    const std::uint64_t each = source_.rays_per_point();
    const std::uint64_t missing = points() - received_;
    if (sent->empty() || sent->count() > services_.limits.chunk_rays_max || sent->count() > missing)
        return refuse(Code::invalid_field, "a frame of " + std::to_string(sent->count()) +
                                               " rays; " + std::to_string(missing) +
                                               " are still to come, and a frame holds 1.." +
                                               std::to_string(services_.limits.chunk_rays_max));
    auto lease = services_.budget.reserve(sent_frame_bytes);
    if (!lease) return refuse(Code::resource_exhausted, "");
    Piece piece;
    piece.sent = *sent;
    piece.sent_first = received_;
    piece.first = received_ * each;
    piece.count = sent->count() * each;
    piece.input_bytes = frame.header.bulk_bytes;
    piece.frame.reset(new SentFrame{std::move(frame.bulk), std::move(*lease), piece.count});
    received_ += sent->count();
    pieces_.push_back(std::move(piece));
    return std::uint64_t{0};
}

std::optional<Task> QueryJob::next() {
    {
        const std::lock_guard lock(mutex_);
        pieces_.insert(pieces_.begin(), given_back_.begin(), given_back_.end());
        given_back_.clear();
    }
    if (pieces_.empty()) return std::nullopt;
    Piece piece = take_piece();
    Task task;
    task.reply_bytes_max = reply_bytes(piece.count);
    // What may be given back keeps its frame for longer.
    if (plan_.query != query_all && !on_cuda(piece))
        task.input_bytes = std::exchange(piece.input_bytes, 0);
    if (source_.rays() * plan_.hits_max <= brief_hits_max && plan_.has_small_trees() &&
        plan_.traversal != traversal_reference && plan_.worker.cuda == nullptr)
        task.brief_hits = piece.count * plan_.hits_max;
    task.lane = on_cuda(piece) ? Lane::device : Lane::compute;
    task.question = question(piece);
    task.run = [this, piece = std::move(piece)](const Stop& stop) {
        tally_.begin();
        return answer_or_fall_back(piece, stop);
    };
    return task;
}

Piece QueryJob::take_piece() {
    const auto take = [this](std::uint64_t most) {
        Piece piece = pieces_.front().split(std::min(most, pieces_.front().count));
        if (pieces_.front().count == 0) pieces_.pop_front();
        return piece;
    };
    const std::uint64_t most = piece_rays(pieces_.front());
    Piece piece = take(most);
    // A frame of rays does not fill a GPU. It gets those that have come, and waits for none.
    while (on_cuda(piece) && !source_.has_points() && piece.count < most && !pieces_.empty() &&
           on_cuda(pieces_.front()) && pieces_.front().first == piece.first + piece.count)
        piece.append(take(most - piece.count));
    return piece;
}

Reply<Frames> QueryJob::answer_or_fall_back(const Piece& piece, const Stop& stop) {
    std::string& fallback = TraceBuffers::of_this_thread().fallback;
    fallback = piece.fallback;
    auto frames = answer(piece, stop);
    if (!on_cuda(piece)) return frames;
    if (frames) {
        for (const Piece& part : piece.parts()) freed_input_ += part.input_bytes;
    } else if (!fallback.empty()) {
        for (Piece& part : piece.parts()) {
            part.fallback = fallback;
            give_back(std::move(part));
        }
        return Frames{};
    }
    return frames;
}

bool QueryJob::needs_input() const {
    return source_.sends() && received_ < points();
}

Frames QueryJob::farewell() {
    wire::DoneT done = tally_.done(plan_);
    done.rows = rows();
    if (plan_.untraced) done.traversal = "none";
    Frames frames;
    frames.push_back(*protocol::encode(id_, done));
    return frames;
}

std::optional<Progress> QueryJob::progress() const {
    return Progress{tally_.rays(), source_.rays(), "tracing"};
}

void QueryJob::free_input(const Piece& piece, std::uint64_t count) {
    if (piece.frame == nullptr || (piece.frame->unanswered -= count) != 0) return;
    freed_input_ += piece.frame->bulk.size();
}

void QueryJob::give_back(Piece rest) {
    const std::lock_guard lock(mutex_);
    given_back_.push_back(std::move(rest));
}

}  // namespace raynest::server

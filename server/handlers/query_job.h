// What all queries do alike: take rays in or make them, hand them out in pieces, count what is
// answered. How a piece becomes an answer is what they differ in.
#pragma once

#include "server/handlers/ray_source.h"

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <vector>

namespace raynest::server {

/// No answer may be larger, so that half of the client's window is enough for it; and cache-sized
/// ones cost less to send than larger ones (1.5 times, measured).
[[nodiscard]] std::uint64_t frame_bytes_max(const Caller& caller);

/// Header and control message of an answer: a name and a description for each of at most 64 blocks.
inline constexpr std::uint64_t answer_head_bytes_max = 8ULL << 10;

class QueryJob : public Job {
public:
    /// Bytes of all answers, headers included: what a detached query reserves. At most; where hits
    /// are not known in advance, what is usual.
    [[nodiscard]] virtual std::uint64_t result_bytes() const = 0;

    Frames greeting() override;
    Reply<std::uint64_t> feed(protocol::Frame frame) override;
    std::optional<Task> next() override;
    [[nodiscard]] bool needs_input() const override;
    [[nodiscard]] bool finished() const override { return all_answered(); }
    Frames farewell() override;
    std::uint64_t take_freed_input() override { return freed_input_.exchange(0); }
    [[nodiscard]] std::optional<Progress> progress() const override;

protected:
    QueryJob(const Services& services, const Caller& caller, Plan plan, RaySource source);

    /// Worker thread: the frames that answer a piece. Adds to the tally what it answered.
    virtual Reply<Frames> answer(const Piece& piece, const Stop& stop) = 0;
    /// What a piece asks, where that may be asked together with others; else null.
    [[nodiscard]] virtual std::shared_ptr<const Question> question(const Piece& /*piece*/) {
        return nullptr;
    }
    /// Rays of the next piece, at most, which begins where `rest` does; on_cuda() says for whom.
    [[nodiscard]] virtual std::uint64_t piece_rays(const Piece& rest) const = 0;
    /// Bulk bytes of the answer to a piece of so many rays, at most.
    [[nodiscard]] virtual std::uint64_t reply_bytes(std::uint64_t rays) const = 0;
    /// Of the whole answer, once all is answered.
    [[nodiscard]] virtual std::uint64_t rows() const = 0;

    /// Worker thread: the rest of a piece goes to another task.
    void give_back(Piece rest);
    /// Worker thread: so many rays are answered of a piece that may be given back in part.
    void free_input(const Piece& piece, std::uint64_t count);
    [[nodiscard]] bool all_answered() const { return tally_.rays() == source_.rays(); }
    [[nodiscard]] bool on_cuda(const Piece& piece) const {
        return plan_.on_cuda(piece.fallback);
    }

    const Services& services_;
    const std::uint64_t id_;
    const Plan plan_;
    const RaySource source_;
    Tally tally_;

private:
    [[nodiscard]] std::uint64_t points() const { return source_.rays() / source_.rays_per_point(); }
    /// The first rays that wait; there are some.
    Piece take_piece();
    /// Worker thread.
    Reply<Frames> answer_or_fall_back(const Piece& piece, const Stop& stop);

    std::deque<Piece> pieces_;  ///< without an answer and not under way
    std::uint64_t received_ = 0;
    std::atomic<std::uint64_t> freed_input_{0};
    std::mutex mutex_;
    std::vector<Piece> given_back_;
};

}  // namespace raynest::server

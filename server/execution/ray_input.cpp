#include "server/execution/ray_input.h"

#include <algorithm>
#include <iterator>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t whole_bytes = sizeof(Ray);
constexpr std::uint32_t rangeless_bytes = 2 * sizeof(Vec3);
constexpr std::uint32_t direction_bytes = sizeof(Vec3);

/// Bytes of memory that a waiting frame takes besides its bulk part, which the credit covers. It is
/// reserved because it exceeds the smallest bulk part, 64 bytes.
constexpr std::uint64_t received_bytes = 512;

/// The mask of a ray that has none of its own.
constexpr std::uint32_t no_mask = ~std::uint32_t{0};

/// Makes rays from the `vectors` that were sent for each; the other members come from `common`.
template <std::size_t vectors>
void widen_from(const Vec3* sent, const Ray& common, std::span<Ray> rays) {
    for (Ray& out : rays) {
        // Assign each member: g++ builds a whole Ray on the stack first, which takes a third
        // longer.
        out.origin = vectors == 2 ? sent[0] : common.origin;
        out.tmin = common.tmin;
        out.direction = sent[vectors - 1];
        out.tmax = common.tmax;
        sent += vectors;
    }
}

}  // namespace

Reply<SentRays> SentRays::of(const protocol::Opened<wire::QueryRays>& message) {
    const std::span blocks(message.blocks);
    const bool masked = blocks.size() == 2;
    const auto block =
        protocol::only_block(masked ? blocks.first(1) : blocks, "rays", wire::Dtype::f32,
                             {whole_bytes, rangeless_bytes, direction_bytes});
    if (!block) return tl::unexpected(block.error());
    const auto masks = masked ? protocol::only_block(blocks.last(1), "masks", wire::Dtype::u32,
                                                     {sizeof(std::uint32_t)})
                              : Reply<protocol::BlockView>();
    if (!masks) return tl::unexpected(masks.error());
    if (masked && masks->count != block->count)
        return refuse(Code::invalid_field, "a frame of " + std::to_string(block->count) +
                                               " rays has " + std::to_string(masks->count) +
                                               " masks: send one for each ray, or none");
    const wire::Vec3* origin = message->origin();
    const bool range = message->tmin() != 0 || message->tmax() != 0;
    if (block->stride == direction_bytes && origin == nullptr)
        return refuse(Code::invalid_field,
                      "rays of 12 bytes are directions: their frame needs an origin");
    if (block->stride != direction_bytes && origin != nullptr)
        return refuse(Code::invalid_field,
                      "the frame has an origin, and so does each of its rays: send directions "
                      "alone, of 12 bytes");
    if (block->stride == whole_bytes && range)
        return refuse(Code::invalid_field,
                      "the frame has tmin and tmax, and so does each of its rays: send them "
                      "without, of 24 or 12 bytes");
    SentRays sent;
    sent.bytes_ = block->bytes;
    sent.stride_ = block->stride;
    if (masked) sent.masks_ = masks->values<std::uint32_t>();
    if (origin != nullptr) sent.common_.origin = {origin->x(), origin->y(), origin->z()};
    sent.common_.tmin = message->tmin();
    if (message->tmax() != 0) sent.common_.tmax = message->tmax();
    return sent;
}

std::span<const Ray> SentRays::whole(std::uint64_t first, std::uint64_t count) const {
    return {reinterpret_cast<const Ray*>(bytes_.data()) + first, count};
}

void SentRays::widen(std::uint64_t first, std::span<Ray> out) const {
    if (are_whole()) {
        std::ranges::copy(whole(first, out.size()), out.begin());
        return;
    }
    const auto* vectors = reinterpret_cast<const Vec3*>(bytes_.data() + first * stride_);
    stride_ == direction_bytes ? widen_from<1>(vectors, common_, out)
                               : widen_from<2>(vectors, common_, out);
}

Reply<std::uint64_t> RayInput::feed(protocol::Frame frame) {
    const auto message = protocol::open<wire::QueryRays>(frame, limits_);
    if (!message) return tl::unexpected(message.error());
    const auto sent = SentRays::of(*message);
    if (!sent) return tl::unexpected(sent.error());
    if ((*message)->first_ray() != received_)
        return refuse(Code::invalid_field,
                      "first_ray is " + std::to_string((*message)->first_ray()) +
                          ", the rays so far are " + std::to_string(received_));
    const std::uint64_t missing = sent_ - received_;
    if (sent->empty() || sent->count() > limits_.chunk_rays_max || sent->count() > missing)
        return refuse(Code::invalid_field, "a frame of " + std::to_string(sent->count()) +
                                               " rays; " + std::to_string(missing) +
                                               " are still to come, and a frame holds 1.." +
                                               std::to_string(limits_.chunk_rays_max));
    auto lease = budget_.reserve(received_bytes, principal_);
    if (!lease) return refuse(Code::resource_exhausted, "");
    const std::uint64_t rays = sent->count() * rays_each_;
    if (!sent->masks().empty()) has_masks_ = true;
    const std::lock_guard lock(mutex_);
    frames_.push_back({received_, *sent, std::move(frame.bulk), std::move(*lease), rays});
    received_ += sent->count();
    return rays;
}

RayInput::Received& RayInput::frame_of(std::uint64_t first) {
    const auto behind = std::upper_bound(
        frames_.begin(), frames_.end(), first,
        [](std::uint64_t number, const Received& frame) { return number < frame.first; });
    return *std::prev(behind);
}

std::span<const Ray> RayInput::sent(std::uint64_t first, std::uint64_t count,
                                    TraceBuffers& buffers) {
    std::span<Ray> out;
    while (out.data() == nullptr || !out.empty()) {
        std::unique_lock lock(mutex_);
        const Received& frame = frame_of(first);
        const SentRays sent = frame.sent;
        const std::uint64_t skipped = first - frame.first;
        lock.unlock();
        const std::uint64_t held = sent.count() - skipped;
        if (out.data() == nullptr) {
            if (sent.are_whole() && held >= count) return sent.whole(skipped, count);
            buffers.resize(buffers.sent, count);
            out = buffers.sent;
        }
        const auto here = static_cast<std::size_t>(std::min<std::uint64_t>(held, out.size()));
        sent.widen(skipped, out.first(here));
        out = out.subspan(here);
        first += here;
    }
    return buffers.sent;
}

Reply<std::span<const std::uint32_t>> RayInput::masks(std::uint64_t first, std::uint64_t count,
                                                      TraceBuffers& buffers) {
    if (!has_masks_) return std::span<const std::uint32_t>();
    buffers.resize(buffers.masks, count);
    for (std::span<std::uint32_t> out = buffers.masks; !out.empty();) {
        std::unique_lock lock(mutex_);
        const Received& frame = frame_of(first / rays_each_);
        const std::span<const std::uint32_t> sent = frame.sent.masks();
        const std::uint64_t skipped = first - frame.first * rays_each_;
        const std::uint64_t held = frame.sent.count() * rays_each_ - skipped;
        lock.unlock();
        const auto here = static_cast<std::size_t>(std::min<std::uint64_t>(held, out.size()));
        for (std::size_t i = 0; i < here; ++i)
            out[i] = sent.empty() ? no_mask : sent[(skipped + i) / rays_each_];
        out = out.subspan(here);
        first += here;
    }
    if (auto few = count_masks(buffers.masks); !few) return tl::unexpected(few.error());
    return std::span<const std::uint32_t>(buffers.masks);
}

Reply<void> RayInput::count_masks(std::span<const std::uint32_t> masks) {
    std::vector<std::uint32_t> different;
    const auto add = [&](std::vector<std::uint32_t>& to, std::uint32_t mask) {
        if (std::ranges::find(to, mask) == to.end()) to.push_back(mask);
        return to.size() <= limits_.ray_masks_max;
    };
    bool few = true;
    for (std::size_t i = 0; few && i < masks.size(); ++i)
        if (i == 0 || masks[i] != masks[i - 1]) few = add(different, masks[i]);
    const std::lock_guard lock(mutex_);
    for (std::size_t i = 0; few && i < different.size(); ++i)
        few = add(different_masks_, different[i]);
    if (few) return {};
    return refuse(Code::limit_exceeded, "the rays of one query have at most ray_masks_max = " +
                                            std::to_string(limits_.ray_masks_max) +
                                            " different masks; send several queries");
}

void RayInput::release(std::uint64_t first, std::uint64_t count) {
    const std::lock_guard lock(mutex_);
    while (count != 0) {
        Received& frame = frame_of(first / rays_each_);
        const std::uint64_t end = (frame.first + frame.sent.count()) * rays_each_;
        const std::uint64_t here = std::min(count, end - first);
        first += here;
        count -= here;
        if ((frame.unanswered -= here) != 0) continue;
        freed_bytes_ += frame.bulk.size();
        frame.bulk = {};
    }
    while (!frames_.empty() && frames_.front().unanswered == 0) frames_.pop_front();
}

}  // namespace raynest::server

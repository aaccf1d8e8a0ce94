#include "server/jobs/sent_sweep.h"

#include "protocol/control.h"
#include "server/execution/trajectory.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <string>

namespace raynest::server {
namespace {

std::span<const double> numbers(std::span<const std::byte> bytes) {
    return {reinterpret_cast<const double*>(bytes.data()), bytes.size() / sizeof(double)};
}

}  // namespace

std::uint64_t SweepOrder::sent_bytes() const {
    return (poses * std::uint64_t{Trajectory::row_numbers} +
            (sends_elevations ? channels.size() : 0) + (turn ? 0 : columns)) *
           sizeof(double);  // a camera has neither channels nor columns
}

Reply<void> check_elevations(std::span<const LidarChannel> channels) {
    const auto lies_within = [](double elevation) { return std::abs(elevation) <= 90; };
    if (std::ranges::all_of(channels, lies_within, &LidarChannel::elevation)) return {};
    return refuse(Code::invalid_field, "elevations must lie between -90 and 90 degrees");
}

void SentSweep::begin(Budget::Lease lease) {
    lease_ = std::move(lease);
    file_.emplace(0, order_.sent_bytes());
}

Reply<std::uint64_t> SentSweep::feed(protocol::Frame frame, const protocol::Limits& limits) {
    const auto message = protocol::open<wire::Upload>(frame, limits);
    if (!message) return tl::unexpected(message.error());
    const auto block = protocol::only_block(message->blocks, "data", wire::Dtype::u8, {1});
    if (!block) return tl::unexpected(block.error());
    auto to = file_->place(*message->table, block->bytes.size());
    if (!to) return tl::unexpected(to.error());
    return copies_.add(block->bytes, *to, std::move(frame));
}

std::optional<Task> SentSweep::next() {
    if (auto copy = copies_.next()) return copy;
    if (needs_input() || !copies_.all_copied() || made_ != Made::no) return std::nullopt;
    made_ = Made::runs;
    Task task;
    task.run = [this](const Stop& stop) -> Reply<Frames> {
        if (auto made = make(stop); !made) return tl::unexpected(made.error());
        return Frames{};
    };
    return task;
}

void SentSweep::ended() {
    copies_.ended();
    if (made_ == Made::runs) made_ = Made::done;
}

Reply<void> SentSweep::make(const Stop& stop) {
    std::span<const double> rest = numbers(file_->bytes());
    const auto take = [&](std::size_t count) {
        const std::span<const double> taken = rest.first(count);
        rest = rest.subspan(count);
        return taken;
    };
    const auto trajectory = Trajectory::of(take(order_.poses * Trajectory::row_numbers));
    if (!trajectory) return tl::unexpected(trajectory.error());
    std::vector<LidarChannel> channels = order_.channels;
    if (order_.sends_elevations)
        for (LidarChannel& channel : channels) channel.elevation = take(1).front();
    std::vector<double> divided;
    for (std::uint32_t i = 0; order_.turn && i < order_.columns; ++i)
        divided.push_back(order_.turn->first +
                          (order_.turn->second - order_.turn->first) * i / order_.columns);
    const std::span<const double> azimuths = order_.turn ? divided : take(order_.columns);
    const auto is_finite = [](double angle) { return std::isfinite(angle); };
    if (!std::ranges::all_of(azimuths, is_finite) ||
        !std::ranges::all_of(channels, is_finite, &LidarChannel::elevation))
        return refuse(Code::invalid_field, "elevations and azimuths must be finite");
    if (auto good = check_elevations(channels); !good) return good;
    std::vector<Pose> poses;
    poses.reserve(order_.all_lines());
    velocities_.reserve(order_.all_lines());
    for (std::uint64_t i = 0; i < order_.all_lines(); ++i) {
        if (i % 4096 == 0 && stop.requested()) return refuse(Code::cancelled, "");
        const double time = order_.time_of(i);
        if (!(time >= trajectory->begin() && time <= trajectory->end()))
            return refuse(Code::invalid_field, "the sensor measures at " + std::to_string(time) +
                                                   ", the trajectory lasts from " +
                                                   std::to_string(trajectory->begin()) + " to " +
                                                   std::to_string(trajectory->end()));
        poses.push_back(trajectory->at(time));
        velocities_.emplace_back(trajectory->velocity_at(time));
    }
    if (order_.camera)
        sensor_.emplace(RollingShutter(*order_.camera, std::move(poses)));
    else
        sensor_.emplace(Sweep(order_.limits, channels, azimuths, std::move(poses)));
    return {};
}

}  // namespace raynest::server

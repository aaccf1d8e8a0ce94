#include "server/execution/step_order.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace raynest::server {

StepOrder::StepOrder(const SweepGrid& grid, std::uint64_t first, std::uint64_t count,
                     std::uint64_t steps, std::span<const std::uint64_t> cuts)
    : grid_(grid),
      first_(first),
      end_(first + count) {
    const std::uint64_t each = grid.columns * grid.channels;
    steps = std::min(steps, grid.columns);
    std::uint64_t place = 0;
    for (std::uint64_t scan = first / each; scan < grid.scans && scan * each < end_; ++scan) {
        const std::uint64_t begin = std::max(scan * each, first_);
        scans_.push_back({begin - first_, std::min((scan + 1) * each, end_) - begin});
        const std::uint64_t row = begin / grid.columns;
        const std::uint64_t last = (begin + scans_.back().count - 1) / grid.columns;
        std::uint64_t from = 0;
        for (const std::uint64_t to : ends_of(scan, steps, cuts)) {
            Step step{place, 0, scan, std::exchange(from, to), to};
            for (const std::uint64_t edge : {row, last}) {
                const Range rays = rays_of(edge, step.begin, step.end);
                step.count += rays.end - rays.first;
                if (row == last) break;
            }
            if (last > row + 1) step.count += (last - row - 1) * (step.end - step.begin);
            if (step.count == 0) continue;
            place += step.count;
            steps_.push_back(step);
        }
    }
}

std::vector<std::uint64_t> StepOrder::ends_of(std::uint64_t scan, std::uint64_t steps,
                                              std::span<const std::uint64_t> cuts) const {
    std::vector<std::uint64_t> ends;
    for (std::uint64_t s = 1; s <= steps; ++s) ends.push_back(s * grid_.columns / steps);
    const std::uint64_t before = scan * grid_.columns;
    auto cut = std::ranges::upper_bound(cuts, before);
    for (; cut != cuts.end() && *cut < before + grid_.columns; ++cut) ends.push_back(*cut - before);
    std::ranges::sort(ends);
    const auto twice = std::ranges::unique(ends);
    ends.erase(twice.begin(), twice.end());
    return ends;
}

StepOrder::Range StepOrder::rays_of(std::uint64_t row, std::uint64_t begin,
                                    std::uint64_t end) const {
    const std::uint64_t first = std::clamp(row * grid_.columns + begin, first_, end_);
    return {first, std::clamp(row * grid_.columns + end, first, end_)};
}

std::uint64_t StepOrder::first_row(std::uint64_t scan) const {
    return std::max(scan * grid_.channels, first_ / grid_.columns);
}

std::size_t StepOrder::step_at(std::uint64_t place) const {
    const auto behind = std::ranges::upper_bound(steps_, place, {}, &Step::first);
    return static_cast<std::size_t>(behind - steps_.begin()) - 1;
}

std::size_t StepOrder::scan_at(std::uint64_t place) const {
    const auto behind = std::ranges::upper_bound(scans_, place, {}, &Scan::first);
    return static_cast<std::size_t>(behind - scans_.begin()) - 1;
}

void StepOrder::numbers(std::uint64_t first, std::span<std::uint64_t> out) const {
    const Step& step = steps_[step_at(first)];
    std::uint64_t skipped = first - step.first;
    std::size_t made = 0;
    for (std::uint64_t row = first_row(step.scan); made < out.size(); ++row) {
        const Range rays = rays_of(row, step.begin, step.end);
        const std::uint64_t skips = std::min(skipped, rays.end - rays.first);
        skipped -= skips;
        for (std::uint64_t ray = rays.first + skips; ray < rays.end && made < out.size(); ++ray)
            out[made++] = ray;
    }
}

StepOrder::Run StepOrder::run_at(std::uint64_t ray) const {
    const std::uint64_t number = first_ + ray;
    const std::uint64_t row = number / grid_.columns;
    const std::uint64_t column = number % grid_.columns;
    const std::uint64_t scan = row / grid_.channels;
    const auto behind =
        std::ranges::upper_bound(steps_, std::pair(scan, column), {},
                                 [](const Step& step) { return std::pair(step.scan, step.begin); });
    const Step& step = *std::prev(behind);
    const std::uint64_t top = first_row(scan);
    std::uint64_t before = 0;
    if (row > top) {
        const Range rays = rays_of(top, step.begin, step.end);
        before = rays.end - rays.first + (row - top - 1) * (step.end - step.begin);
    }
    const Range rays = rays_of(row, step.begin, step.end);
    return {step.first + before + (number - rays.first), rays.end - number};
}

}  // namespace raynest::server

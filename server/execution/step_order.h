// The steps of a scene that moves while a sensor turns, and the order of rays that follows.
//
//   scan 0: columns  0 .. w | w .. 2w | ...      A step has some columns of one scan, of all
//           step     0      | 1       | ...      channels. Its rays are traced one behind the other,
//                                                channel by channel: their numbers in this order are
//   scan 1: ...                                  places.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace raynest::server {

/// The rays of a sweep, as its order counts them: ray (scan * channels + c) * columns + j.
struct SweepGrid {
    std::uint64_t columns = 0, channels = 0, scans = 0;
};

/// Thread-safe.
class StepOrder {
public:
    struct Step {
        std::uint64_t first = 0;  ///< place
        std::uint64_t count = 0;  ///< number of rays; above 0
        std::uint64_t scan = 0;
        std::uint64_t begin = 0, end = 0;  ///< columns of the scan
    };
    struct Scan {
        std::uint64_t first = 0;  ///< ray, counted from that of the order on; also the first place
        std::uint64_t count = 0;
    };

    /// Orders rays [first, first + count) of a sweep. Each scan has `steps` equal ones, at most one per
    /// column, and others begin at `cuts`: columns, counted through all scans, ascending. Steps without a
    /// ray are left out.
    StepOrder(const SweepGrid& grid, std::uint64_t first, std::uint64_t count, std::uint64_t steps,
              std::span<const std::uint64_t> cuts = {});

    [[nodiscard]] const SweepGrid& grid() const { return grid_; }
    [[nodiscard]] std::span<const Step> steps() const { return steps_; }
    /// Those with rays.
    [[nodiscard]] std::span<const Scan> scans() const { return scans_; }
    [[nodiscard]] std::size_t step_at(std::uint64_t place) const;
    [[nodiscard]] std::size_t scan_at(std::uint64_t place) const;
    /// Writes the numbers that the rays of places [first, first + out.size()) have in the sweep;
    /// they are of one step.
    void numbers(std::uint64_t first, std::span<std::uint64_t> out) const;

    /// Places that follow each other, as their rays do.
    struct Run {
        std::uint64_t place = 0;
        std::uint64_t count = 0;
    };
    /// Returns the run that begins with a ray, counted from that of the order on.
    [[nodiscard]] Run run_at(std::uint64_t ray) const;

private:
    struct Range {
        std::uint64_t first, end;
    };
    /// The rays of a row of the sweep that are of these columns and of the order.
    [[nodiscard]] Range rays_of(std::uint64_t row, std::uint64_t begin, std::uint64_t end) const;
    /// Where the steps of a scan end, ascending.
    [[nodiscard]] std::vector<std::uint64_t> ends_of(std::uint64_t scan, std::uint64_t steps,
                                                     std::span<const std::uint64_t> cuts) const;
    /// The first row of a scan that the order has.
    [[nodiscard]] std::uint64_t first_row(std::uint64_t scan) const;

    const SweepGrid grid_;
    const std::uint64_t first_, end_;
    std::vector<Step> steps_;
    std::vector<Scan> scans_;
};

}  // namespace raynest::server

// --generate KIND key=value...: rays that the daemon makes. The daemon checks the words. The client
// reads only positions, which it sends relative to the scene's origin, and a file of points.
#pragma once

#include "client/ground/failure.h"
#include "client/requests/request_options.h"
#include "protocol/blocks.h"
#include "protocol/wire.h"

#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace raynest::client {

struct Generate {
    wire::GeneratorT message;     ///< without pose and lookat
    std::string points;           ///< file of the points where rays start
    std::string trajectory;       ///< file of the poses of a sensor in motion
    std::string elevations;       ///< file of degrees; empty: they are among the message's settings
    std::string azimuths;         ///< likewise
    std::vector<double> pose;     ///< 12 numbers or empty
    std::vector<double> look_at;  ///< 6 or 9 numbers or empty

    /// Returns where the sensor stands; nothing where the scene or a file of points says it.
    [[nodiscard]] std::optional<WorldPoint> start() const;
    /// Returns the message for a scene with this origin.
    [[nodiscard]] wire::GeneratorT at(const WorldPoint& origin) const;
};

/// Reads the words of --generate; exit code 2 if one is not key=value.
Result<Generate> parse_generate(std::span<const std::string> words);

/// Reads the files of a sensor in motion: the bytes that follow the request, with positions relative
/// to this origin; nothing for other generators. Adds their counts to the settings of `to`. Exit code 5
/// for a trajectory that is not an array of shape (N, 13), a time and a 3x4 matrix in each row, and for
/// angles that are not one of shape (N,).
Result<std::vector<std::byte>> read_sent_numbers(const Generate& generate, const WorldPoint& origin,
                                                 wire::GeneratorT& to);

/// The columns `ring` and `time` of a lidar or a sweep: they follow from the numbers of its rays, so
/// that the client makes them.
class SensorColumns {
public:
    /// The names of those that the sensor of a generator has.
    static std::vector<std::string> of(const wire::GeneratorT& generator);
    /// Takes those names that are such columns out of `fields`. Exit code 2 where the sensor has none.
    static Result<SensorColumns> take(std::vector<std::string>& fields,
                                      const wire::GeneratorT* generator);
    [[nodiscard]] bool empty() const { return names_.empty(); }
    [[nodiscard]] const std::vector<std::string>& names() const { return names_; }
    /// Calls `use` with `columns` and, behind them, these of rays [first, first + count): blocks of
    /// u64, which hold those of `ring`, and those of `time` as float64.
    Result<void> beside(
        std::span<const protocol::BlockView> columns, std::uint64_t first, std::uint64_t count,
        const std::function<Result<void>(std::span<const protocol::BlockView>)>& use) const;

private:
    std::vector<std::string> names_;
    std::uint64_t channels_ = 1, columns_ = 1;
    bool by_rows_ = false;     ///< a time per row of a picture; else per column of a scan
    std::uint64_t lines_ = 1;  ///< rows or columns
    double begin_ = 0, end_ = 0;
};
/// True for a block that SensorColumns has made of float64, or of a ring.
[[nodiscard]] bool is_time(const protocol::BlockView& block);
[[nodiscard]] bool is_ring(const protocol::BlockView& block);

/// The number of rays of a sensor, as its settings say it; 0 where the daemon will refuse them.
[[nodiscard]] std::uint64_t sensor_rays(const wire::GeneratorT& generator);
/// The rays of a band of a sensor's tiles, which the daemon traces faster together; 1 of a lidar
/// or a sweep.
[[nodiscard]] std::uint64_t sensor_band(const wire::GeneratorT& generator);

/// Returns the help: every kind with its keys, and every key with its text.
[[nodiscard]] std::string generate_help();

}  // namespace raynest::client

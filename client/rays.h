// Where a query's rays come from: the command line or a .npy file.
#pragma once

#include "client/failure.h"
#include "client/npy.h"
#include "client/options.h"
#include "client/scene_origin.h"
#include "protocol/buffer.h"
#include "protocol/wire.h"

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace raynest::client {

class RaySource {
public:
    /// Rays of the command line, less the scene's origin.
    explicit RaySource(const std::vector<WorldRay>& rays, const WorldPoint& scene_origin = {});
    /// `width` values for each ray, as they travel: 3 with an origin, else 6 or 8.
    RaySource(std::vector<float> values, std::uint32_t width,
              const std::optional<wire::Vec3>& common_origin = std::nullopt);
    /// An array of shape (N, 6), origins and directions, or (N, 8), with tmin and tmax, or, where
    /// all start at one point, (N, 3), directions; one ray may lack its brackets, and there may be
    /// none. Any real numbers, which are rounded to float32. Exit code 5 for anything else.
    static Result<RaySource> open(const std::string& path, const std::optional<WorldPoint>& from,
                                  const WorldPoint& scene_origin = {});
    /// The same of points, whose directions are normals: each has its own origin.
    static Result<RaySource> open_points(const std::string& path,
                                         const WorldPoint& scene_origin = {});

    [[nodiscard]] std::uint64_t count() const { return count_; }
    /// Of all rays, which then bring their directions alone.
    [[nodiscard]] const std::optional<wire::Vec3>& common_origin() const { return common_origin_; }
    /// What was subtracted from the points of rays.
    [[nodiscard]] const WorldPoint& scene_origin() const { return scene_origin_; }
    /// Values of a ray as it travels: 3, 6 or 8.
    [[nodiscard]] std::uint32_t width() const { return width_; }
    [[nodiscard]] std::uint64_t ray_bytes() const { return width_ * sizeof(float); }
    /// Rays [first, first + count) as they travel, where they lie so in memory; else nothing.
    [[nodiscard]] std::span<const std::byte> bytes(std::uint64_t first, std::uint64_t count) const;
    /// Rays that float32 moves by more than `notable` from where they were meant to start. Of those
    /// that a file holds in float32 that is half a step of it.
    struct Rounding {
        std::uint64_t count = 0;
        std::uint64_t first = 0;
        double farthest = 0;
    };
    [[nodiscard]] Rounding rounding(double notable) const;
    /// True where a file holds the rays in float32.
    [[nodiscard]] bool is_float32() const;
    /// Writes the values of the rays from `first` on, until `out` is full.
    void read(std::uint64_t first, std::span<float> out) const;

private:
    RaySource() = default;
    /// One of these widths; `shapes` says so to people.
    static Result<RaySource> open(const std::string& path, const WorldPoint& scene_origin,
                                  std::initializer_list<std::uint64_t> widths,
                                  const std::string& shapes);
    /// True where rays of the file are not sent as they lie in it.
    [[nodiscard]] bool subtracts() const;
    /// How far float32 moves the start of a ray.
    [[nodiscard]] double moved(std::uint64_t ray) const;

    std::vector<float> values_;
    std::vector<double> moved_;  ///< of the rays in values_, or of all rays
    protocol::Buffer file_;
    Array array_;
    std::uint64_t count_ = 0;
    std::uint32_t width_ = 8;
    std::optional<wire::Vec3> common_origin_;
    WorldPoint scene_origin_{};
};

/// What to say where rays lose digits that count beside the size of the scene; "" where none do.
[[nodiscard]] std::string rounding_warning(const RaySource& rays, const SceneOrigin& scene);

}  // namespace raynest::client

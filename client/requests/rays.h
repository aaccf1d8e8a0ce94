// The rays of a query, from the command line or a .npy file.
#pragma once

#include "client/files/npy.h"
#include "client/ground/failure.h"
#include "client/requests/request_options.h"
#include "client/requests/scene_origin.h"
#include "protocol/buffer.h"
#include "protocol/wire.h"

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

class RaySource {
public:
    /// Takes rays of the command line; subtracts the scene's origin.
    explicit RaySource(const std::vector<WorldRay>& rays, const WorldPoint& scene_origin = {});
    /// Takes `width` values per ray, in the form that is sent: 3 with an origin, else 6 or 8.
    RaySource(std::vector<float> values, std::uint32_t width,
              const std::optional<wire::Vec3>& common_origin = std::nullopt);
    /// Opens an array of shape (N, 6), origins and directions, (N, 8), with tmin and tmax, or, if
    /// all start at one point, (N, 3), directions. One ray may also be (6,), (8,) or (3,); N may be
    /// 0. Any real numbers are rounded to float32. Exit code 5 for anything else.
    static Result<RaySource> open(const std::string& path, const std::optional<WorldPoint>& from,
                                  const WorldPoint& scene_origin = {});
    /// The same for points with normals as directions; each point is an origin.
    static Result<RaySource> open_points(const std::string& path,
                                         const WorldPoint& scene_origin = {});

    [[nodiscard]] std::uint64_t count() const { return count_; }
    /// Takes a mask for each ray, or point, from an array of shape (N,) of whole numbers below 2^32.
    /// Exit code 5 for anything else.
    Result<void> open_masks(const std::string& path);
    /// The mask of each ray; empty: they have none of their own.
    [[nodiscard]] std::span<const std::uint32_t> masks() const { return masks_; }
    /// Leaves out all but the rays of a part, which count from 0 then.
    void keep(const PartRange& range);
    /// The common origin of rays that have only directions.
    [[nodiscard]] const std::optional<wire::Vec3>& common_origin() const { return common_origin_; }
    /// The point that was subtracted from the rays' origins.
    [[nodiscard]] const WorldPoint& scene_origin() const { return scene_origin_; }
    /// Number of values per sent ray: 3, 6 or 8.
    [[nodiscard]] std::uint32_t width() const { return width_; }
    [[nodiscard]] std::uint64_t ray_bytes() const { return width_ * sizeof(float); }
    /// Returns rays [first, first + count) if memory has them in that form; else empty.
    [[nodiscard]] std::span<const std::byte> bytes(std::uint64_t first, std::uint64_t count) const;
    /// Statistics of the rays whose origin float32 moves by more than `notable`. For a file in
    /// float32 the move is taken to be half a step.
    struct Rounding {
        std::uint64_t count = 0;
        std::uint64_t first = 0;
        double farthest = 0;
    };
    [[nodiscard]] Rounding rounding(double notable) const;
    /// True if a file has the rays in float32.
    [[nodiscard]] bool is_float32() const;
    /// Fills `out` with the values of rays from `first` on.
    void read(std::uint64_t first, std::span<float> out) const;

private:
    RaySource() = default;
    /// Opens a file with one of these widths; `shapes` is the text for messages.
    static Result<RaySource> open(const std::string& path, const WorldPoint& scene_origin,
                                  std::initializer_list<std::uint64_t> widths,
                                  const std::string& shapes);
    /// True if a scene origin must be subtracted from the file's rays.
    [[nodiscard]] bool subtracts() const;
    /// Returns how far float32 moves the origin of a ray.
    [[nodiscard]] double moved(std::uint64_t ray) const;

    std::vector<float> values_;
    std::vector<std::uint32_t> masks_;
    std::vector<double> moved_;  ///< for the rays in values_, or for all rays
    protocol::Buffer file_;
    Array array_;
    std::uint64_t first_ = 0;  ///< number of the first ray that is kept
    std::uint64_t count_ = 0;
    std::uint32_t width_ = 8;
    std::optional<wire::Vec3> common_origin_;
    WorldPoint scene_origin_{};
};

/// Returns a warning if rays lose digits that matter at the scale of the scene, else "". It begins
/// with `subject` in place of the number of rays, as "the sensor stands", if `rays` is where one
/// stands.
[[nodiscard]] std::string rounding_warning(const RaySource& rays, const SceneOrigin& scene,
                                           std::string_view subject = {});

}  // namespace raynest::client

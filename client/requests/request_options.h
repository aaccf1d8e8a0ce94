// The options that requests are made of, as users say them; several commands have them.
#pragma once

#include "client/ground/failure.h"
#include "client/ground/lists.h"
#include "protocol/wire.h"

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace raynest::client {

using Ray = std::array<float, 8>;  ///< ox oy oz tmin dx dy dz tmax
using WorldRay = std::array<double, 8>;
/// A point in the world; points are sent relative to the scene's origin.
using WorldPoint = std::array<double, 3>;

/// The values of a parameter that is a table.
struct TableOption {
    std::string name;
    std::vector<float> values;
};

/// A moment of an animation of the scene.
struct MomentOptions {
    std::optional<double> time;  ///< seconds within the animation; nothing: the scene as it is
    std::string animation;
};

/// Options of render, query and heatmap.
struct JobOptions : MomentOptions {
    std::string scene;
    std::string intersector;
    std::vector<std::string> settings;  ///< "name=value", "name=@FILE" before read_tables()
    std::vector<TableOption> tables;
    std::string traversal;
    std::uint32_t mask = 0xFFFFFFFF;
    std::uint64_t epoch = 0;
    std::string worker;
    std::string priority;
    double deadline = 0;  ///< seconds; 0 = none
    bool detach = false;
    /// "inst=N", "object=N", "path=N" or the text of paths
    std::vector<std::string> hide, only;
    bool skip_hidden_boxes = false;
};

struct CameraOptions {
    std::string name;
    std::vector<double> look_at;  ///< empty, 6 or 9 values, in the world
    float fov_degrees = 0;
    std::uint32_t width = 960;
    std::uint32_t height = 540;
};

/// One of `count` parts of a request, number 1 and up; count 0: all of it.
struct PartOption {
    std::uint64_t number = 1, count = 0;
};
/// Items [first, first + count) of a request.
struct PartRange {
    std::uint64_t first = 0, count = 0;
};
/// Parts of a picture begin at multiples of so many rows: a block of an EXR.
inline constexpr std::uint64_t part_rows = 16;
/// The items of a part of `all`, whose parts begin at multiples of `step`; the whole without a
/// part. Exit code 2 where there are fewer steps than parts.
Result<PartRange> part_of(const PartOption& part, std::uint64_t all, std::uint64_t step,
                          const char* items);

/// Options of render and heatmap.
struct PictureOptions {
    JobOptions job;
    CameraOptions camera;
    std::string output;
    PartOption part;
};
/// How light is followed: options of render and explain.
struct LightOptions : SettingNumbers {
    std::string integrator;
    std::uint64_t seed = 0;
    std::string environment;                  ///< auto | sky | none | a file
    std::optional<std::array<float, 2>> sun;  ///< azimuth and elevation in degrees
};

/// The other side of a difference: what differs from the job itself.
struct Difference {
    std::string scene, intersector;
    std::vector<std::string> settings;  ///< as those of a job
    std::vector<TableOption> tables;
    std::optional<std::uint32_t> mask;
    std::optional<std::uint64_t> epoch;
};

/// How a ray is written.
inline constexpr const char* ray_form = "ox,oy,oz,dx,dy,dz or ox,oy,oz,tmin,dx,dy,dz,tmax";

/// Parses "ox,oy,oz,dx,dy,dz" or "ox,oy,oz,tmin,dx,dy,dz,tmax", the order of .npy files.
Result<WorldRay> parse_ray(const std::string& text);

/// Checks a text of --hide or --only; one without such a key is the text of paths.
Result<void> check_selection(const std::string& text);
/// Adds --hide and --only to the lists of a Job.
void add_selection(const JobOptions& options, wire::JobT& job);

}  // namespace raynest::client

// From a file's unit to float32 in the scene's space.
#include "engine/assets/formats/file_content.h"
#include "engine/assets/input/messages.h"
#include "engine/geometry/sphere_shape.h"
#include "engine/math/float_step.h"
#include "engine/scene/precision.h"
#include "engine/scene/snapshot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

namespace raynest {
namespace {

/// Rounding of more than this share of the scene's size makes an origin useful.
constexpr double notable_share = 1e-7;

bool in_range(const glm::dvec3& point) {
    return is_origin({point.x, point.y, point.z});
}

/// The map of a file's points to the world, and from there to the scene.
class Placing {
public:
    Placing(const ImportRequest& request, bool is_float32)
        : unit_(request.options.unit == 0 ? 1 : request.options.unit),
          is_float32_(is_float32),
          origin_(request.origin[0], request.origin[1], request.origin[2]) {}

    [[nodiscard]] glm::dvec3 to_world(const glm::dvec3& point) const { return unit_ * point; }
    [[nodiscard]] double unit() const { return unit_; }

    /// Takes a point into account for the choice of an origin.
    void add(const glm::dvec3& point) {
        const glm::dvec3 at = to_world(point);
        if (!in_range(at)) return;
        lower_ = glm::min(lower_, at);
        upper_ = glm::max(upper_, at);
    }
    /// Chooses an origin of whole metres where float32 would be coarse.
    WorldPoint choose_origin() {
        const glm::dvec3 corner = glm::max(glm::abs(lower_), glm::abs(upper_));
        const double reach = std::max({corner.x, corner.y, corner.z});
        const bool is_far =
            lower_.x <= upper_.x &&
            float_step(static_cast<float>(reach)) > notable_share * glm::length(upper_ - lower_);
        origin_ = is_far ? glm::round((lower_ + upper_) * 0.5) : glm::dvec3(0);
        return {origin_.x, origin_.y, origin_.z};
    }

    Vec3 round(const glm::dvec3& point, SceneDescription& scene) const {
        const glm::dvec3 exact = to_world(point) - origin_;
        const Vec3 rounded(exact);
        scene.rounding = std::max(scene.rounding, glm::length(glm::dvec3(rounded) - exact));
        if (is_float32_)
            scene.file_rounding = std::max(scene.file_rounding, unit_ * half_step(Vec3(point)));
        return rounded;
    }

private:
    double unit_;
    bool is_float32_;
    glm::dvec3 origin_;
    glm::dvec3 lower_{INFINITY}, upper_{-INFINITY};
};

Result<ObjectDescription> place_object(FileObject& from, const Placing& placing,
                                       SceneDescription& scene) {
    ObjectDescription object;
    object.name = std::move(from.name);
    for (FileGeometry& geometry : from.geometries) {
        std::vector<Vec3>& positions = geometry.rest.positions;
        positions.reserve(geometry.positions.size());
        std::uint64_t bad = 0;
        for (const glm::dvec3& point : geometry.positions) {
            bad += in_range(placing.to_world(point)) ? 0U : 1U;
            positions.push_back(placing.round(point, scene));
        }
        if (bad != 0) {
            return fail(
                ErrorCode::scene_invalid,
                fmt::format("has {} {} not finite or beyond 1e15: remove them",
                            counted(bad, "vertex", "vertices"), bad == 1 ? "that is" : "that are"));
        }
        geometry.positions = {};
        object.geometries.push_back(std::move(geometry.rest));
    }
    return object;
}

Result<ObjectDescription> place_points(const FileContent& content, const FileOptions& options,
                                       const Placing& placing, SceneDescription& scene) {
    if (content.radii.empty() && options.radius == 0) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("has {} without a radius, which no ray can hit: load them as "
                                "spheres with `radius`, in units of the file",
                                counted(content.points.size(), "point", "points")));
    }
    ObjectDescription object;
    object.name = "points";
    object.record_type = "sphere";
    std::vector<Sphere> spheres;
    spheres.reserve(content.points.size());
    for (std::size_t i = 0; i < content.points.size(); ++i) {
        const double radius =
            placing.unit() * (content.radii.empty() ? options.radius : content.radii[i]);
        if (!in_range(placing.to_world(content.points[i])) ||
            !(radius > 0 && radius <= double{coordinate_max})) {
            ++scene.skipped["points_not_finite"];
            continue;
        }
        spheres.push_back({placing.round(content.points[i], scene), static_cast<float>(radius)});
        object.record_bounds.push_back(bounds(spheres.back()));
        if (content.point_colours.empty()) continue;
        const auto rgba = content.point_colours.begin() + static_cast<std::ptrdiff_t>(4 * i);
        object.record_colours.insert(object.record_colours.end(), rgba, rgba + 4);
    }
    if (const auto skipped = scene.skipped.find("points_not_finite");
        skipped != scene.skipped.end())
        scene.warnings.push_back(
            fmt::format("{} left out: a coordinate is not finite or beyond 1e15, or the radius is "
                        "not above 0",
                        counted(skipped->second, "point is", "points are")));
    if (spheres.empty()) return fail(ErrorCode::scene_invalid, "has no point that can be hit");
    object.records.resize(spheres.size() * sizeof(Sphere));
    std::memcpy(object.records.data(), spheres.data(), object.records.size());
    return object;
}

}  // namespace

Result<SceneDescription> place(FileContent content, const ImportRequest& request,
                               const ImportLimits& limits) {
    std::erase_if(content.objects, [](FileObject& object) {
        std::erase_if(object.geometries,
                      [](const FileGeometry& geometry) { return geometry.rest.indices.empty(); });
        return object.geometries.empty();
    });
    std::uint64_t primitives = content.points.size();
    for (const FileObject& object : content.objects)
        for (const FileGeometry& geometry : object.geometries)
            primitives += geometry.rest.indices.size() / 3;
    if (primitives == 0)
        return fail(ErrorCode::scene_invalid, "has no triangle and no point that a ray can hit");
    if (primitives > limits.triangles_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("has {} triangles or points; at most {} are allowed", primitives,
                                limits.triangles_max));
    }
    if (content.objects.size() > limits.nodes_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("has {} objects; at most {} are allowed", content.objects.size(),
                                limits.nodes_max));
    }
    SceneDescription scene;
    scene.origin = request.origin;
    Placing placing(request, content.is_float32);
    if (request.options.auto_origin || (content.is_surveyed && request.origin == WorldPoint{})) {
        for (const glm::dvec3& point : content.points) placing.add(point);
        for (const FileObject& object : content.objects)
            for (const FileGeometry& geometry : object.geometries)
                for (const glm::dvec3& point : geometry.positions) placing.add(point);
        scene.origin = placing.choose_origin();
    }
    scene.warnings = std::move(content.warnings);
    scene.materials = std::move(content.materials);
    scene.textures = std::move(content.textures);
    scene.images = std::move(content.images);
    if (request.options.radius != 0 && (content.points.empty() || !content.radii.empty()))
        scene.warnings.push_back(
            fmt::format("`radius` changes nothing: the file has {}",
                        content.points.empty() ? "no points" : "a radius for each of its points"));
    if (!content.points.empty()) {
        auto points = place_points(content, request.options, placing, scene);
        if (!points) return tl::unexpected<Error>(points.error());
        scene.objects.push_back(std::move(*points));
        return scene;
    }
    const bool is_nameless = content.objects.front().name.empty();
    ObjectDescription root{"scene", {}, {}, {}, {}, {}, {}};
    for (FileObject& from : content.objects) {
        auto object = place_object(from, placing, scene);
        if (!object) return tl::unexpected<Error>(object.error());
        const auto index = static_cast<std::uint32_t>(scene.objects.size());
        if (object->name.empty()) object->name = "mesh";
        root.instances.push_back({index, {}, 0xFFFFFFFFU, index, object->name});
        scene.objects.push_back(std::move(*object));
    }
    if (scene.objects.size() == 1 && is_nameless) return scene;
    scene.root = static_cast<std::uint32_t>(scene.objects.size());
    scene.objects.push_back(std::move(root));
    return scene;
}

}  // namespace raynest

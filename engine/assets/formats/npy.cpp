#include "engine/assets/formats/npy.h"

#include "engine/assets/formats/npy_array.h"
#include "engine/scene/precision.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <span>
#include <string_view>

namespace raynest {
namespace {

struct Array {
    std::vector<std::uint64_t> shape;
    std::vector<float> values;
    double rounding = 0;       ///< largest distance by which float32 rounding moved a point
    double file_rounding = 0;  ///< the same, before the file was written
};

/// The point in each row of an array, and the origin to subtract from it.
struct Points {
    std::array<std::size_t, 3> columns;
    WorldPoint origin;
};
constexpr std::array<std::size_t, 3> record_point{0, 1, 2};
constexpr std::array<std::size_t, 3> matrix_point{3, 7, 11};  ///< the translation of a 3x4 matrix

Result<Array> read_array(const NamedBytes& file, const ImportLimits& limits, const Points& points) {
    const auto file_array = parse_npy(file, limits);
    if (!file_array) return tl::unexpected<Error>(file_array.error());
    Array array;
    array.shape = file_array->shape;
    array.values.resize(file_array->count);
    const std::uint64_t count = file_array->count;
    const std::uint64_t width = file_array->width();
    std::vector<double> shift(width);
    std::vector<bool> is_point(width);
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const std::size_t column = points.columns[axis];
        if (column < width) shift[column] = points.origin[axis], is_point[column] = true;
    }
    std::uint64_t bad = 0;
    double moved_max = 0;  // squared, as is `moved`
    const bool is_float32 = file_array->layout.kind == 'f' && file_array->layout.item == 4;
    for (std::uint64_t row = 0; row < count; row += width) {
        double moved = 0;
        Vec3 stated(0);
        int stated_axis = 0;
        for (std::uint64_t i = 0; i < width; ++i) {
            const double value = file_array->at(row / width, i);
            const double exact = value - shift[i];
            const auto rounded = static_cast<float>(exact);
            array.values[row + i] = rounded;
            bad += std::isfinite(rounded) ? 0U : 1U;
            if (!is_point[i]) continue;
            const double off = double{rounded} - exact;
            moved += off * off;
            stated[stated_axis++] = static_cast<float>(value);
        }
        moved_max = std::max(moved_max, moved);
        if (is_float32) array.file_rounding = std::max(array.file_rounding, half_step(stated));
    }
    array.rounding = std::sqrt(moved_max);
    if (bad != 0)
        return refuse_array(file.name,
                            fmt::format("has {} values that are not finite float32", bad));
    return array;
}

void note_rounding(const Array& array, SceneDescription& scene) {
    scene.rounding = std::max(scene.rounding, array.rounding);
    scene.file_rounding = std::max(scene.file_rounding, array.file_rounding);
}

/// True if a record's first three values are its position, so that its bounds move with them.
bool moves_with_point(const PackPrimitive& primitive, std::span<const float> example) {
    std::vector<float> record(example.begin(), example.end());
    Box before;
    Box after;
    primitive.bounds(record.data(), 1, &before);
    const float step = 1 + glm::length(glm::max(glm::abs(before.lower), glm::abs(before.upper)));
    for (const std::size_t axis : record_point) record[axis] += step;
    primitive.bounds(record.data(), 1, &after);
    const auto moved = [&](const Vec3& from, const Vec3& to) {
        const Vec3 off = glm::abs(to - from - Vec3(step));
        return std::max({off.x, off.y, off.z}) <= 1e-5F * step;
    };
    return moved(before.lower, after.lower) && moved(before.upper, after.upper);
}

/// Returns the names of all record types, each once.
std::set<std::string_view> primitive_names(const Registry& registry) {
    std::set<std::string_view> names;
    for (const Pack* pack : registry.packs())
        for (const PackPrimitive& primitive : std::span(pack->primitives, pack->primitive_count))
            names.insert(primitive.name);
    return names;
}

Result<ObjectDescription> read_records(const ImportRequest& request, const ImportLimits& limits,
                                       const Registry& registry, const WorldPoint& origin,
                                       SceneDescription& scene) {
    const NamedBytes& file = request.files.front();
    const PackPrimitive* primitive =
        request.primitive.empty() ? nullptr : registry.find_primitive(request.primitive);
    if (primitive == nullptr) {
        return fail(
            ErrorCode::scene_invalid,
            fmt::format("there is no primitive type '{}' for the records of '{}'; `primitive` is "
                        "one of {}",
                        request.primitive, file.name, fmt::join(primitive_names(registry), ", ")));
    }
    auto array = read_array(file, limits, {record_point, origin});
    if (!array) return tl::unexpected<Error>(array.error());
    if (array->shape.size() != 2 || array->shape[1] * 4 != primitive->record_size) {
        return refuse_array(file.name,
                            fmt::format("must have shape (N, {}) for primitives of type '{}'",
                                        primitive->record_size / 4, request.primitive));
    }
    const std::uint64_t count = array->shape[0];
    if (count > limits.triangles_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("the scene has more than {} primitives", limits.triangles_max));
    }

    const std::uint64_t width = array->shape[1];
    if (origin != WorldPoint{} &&
        (width < 3 || !moves_with_point(*primitive, std::span(array->values).first(width)))) {
        return fail(ErrorCode::scene_unsupported,
                    fmt::format("the first three values of a {} are not its position, so no origin "
                                "can be subtracted from them: subtract it before saving",
                                request.primitive));
    }
    note_rounding(*array, scene);

    ObjectDescription object;
    object.name = request.primitive + "s";
    object.record_type = request.primitive;
    const auto bytes = std::as_bytes(std::span(array->values));
    object.records.assign(bytes.begin(), bytes.end());
    object.record_bounds.resize(count);
    primitive->bounds(object.records.data(), count, object.record_bounds.data());
    return object;
}

Result<std::vector<InstanceDescription>> read_instances(const NamedBytes& file,
                                                        const ImportLimits& limits,
                                                        const WorldPoint& origin,
                                                        SceneDescription& scene) {
    auto array = read_array(file, limits, {matrix_point, origin});
    if (!array) return tl::unexpected<Error>(array.error());
    const std::vector<std::uint64_t>& shape = array->shape;
    const bool flat = shape.size() == 2 && shape[1] == 12;
    const bool rows = shape.size() == 3 && shape[1] == 3 && shape[2] == 4;
    if (!flat && !rows) return refuse_array(file.name, "must have shape (M, 12) or (M, 3, 4)");
    if (shape[0] > limits.instances_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("the scene has more than {} instances", limits.instances_max));
    }
    note_rounding(*array, scene);
    std::vector<InstanceDescription> instances(shape[0]);
    for (std::size_t i = 0; i < instances.size(); ++i) {
        instances[i].object = 0;
        instances[i].uid = static_cast<std::uint32_t>(i);
        std::copy_n(array->values.data() + 12 * i, 12, instances[i].transform.m.begin());
    }
    return instances;
}

}  // namespace

Result<SceneDescription> describe_npy(const ImportRequest& request, const ImportLimits& limits,
                                      const Registry& registry) {
    SceneDescription scene;
    scene.origin = request.origin;
    // If there are placements, records lie around zero and the placements are in the world.
    const bool is_placed = request.files.size() > 1;
    auto object =
        read_records(request, limits, registry, is_placed ? WorldPoint{} : scene.origin, scene);
    if (!object) return tl::unexpected<Error>(object.error());
    scene.objects.push_back(std::move(*object));
    for (std::size_t i = 1; i < request.files.size(); ++i) {
        if (scene.root != 0)
            return refuse_array(request.files[i].name,
                                "is not used: give only one file of placements");
        auto instances = read_instances(request.files[i], limits, scene.origin, scene);
        if (!instances) return tl::unexpected<Error>(instances.error());
        scene.objects.push_back({"scene", {}, std::move(*instances), {}, {}, {}, {}});
        scene.root = 1;
    }
    return scene;
}

}  // namespace raynest

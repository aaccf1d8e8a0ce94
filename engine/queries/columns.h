// Hit records -> the columns of PROTOCOL.md §7.
//
// Kernels write 32-byte records; whatever else a column needs (names of levels, normals, materials)
// follows from (path, object, triangle) and is computed here, only for the fields asked for.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/path.h"
#include "engine/geometry/pinhole.h"
#include "engine/geometry/ray.h"
#include "engine/geometry/views.h"
#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace raynest {

struct GeometryShading;  // shading/records.h
class Velocities;        // scene/motion/velocities.h

/// Those of fields.def, then the counters.
enum class Field : std::uint32_t {
#define RAYNEST_FIELD(name, ...) name,
#include "engine/queries/fields.def"
#define RAYNEST_COUNTER(name, title) name,
#include "engine/geometry/counters.def"
    count_
};
enum class FieldType : std::uint8_t { u8, u32, u64, f32 };

/// A field, of a counter perhaps of one level of the scene alone.
struct Column {
    static constexpr std::uint32_t all_levels = ~0U;
    Field field = Field::count_;
    std::uint32_t level = all_levels;

    Column() = default;
    Column(Field of, std::uint32_t at = all_levels) : field(of), level(at) {}
    [[nodiscard]] bool of_level() const { return level != all_levels; }
    friend bool operator==(const Column&, const Column&) = default;
};

struct FieldInfo {
    std::string_view name;
    FieldType type;
    std::uint32_t width;  ///< values per element: 2 for uv, 3 for vectors
    bool counter;         ///< needs a counting function
    bool of_ray;          ///< one per ray, however many hits it has
    bool reads_rays;      ///< write_column() looks at the rays
    bool reads_motion;    ///< it needs ColumnSource::velocities, and sensors if there are some
    bool reads_sensor;    ///< it needs ColumnSource::sensors
    /// Is it a column of a query that names none?
    enum class Shown : std::uint8_t { asked, hits, any } shown;
    std::string_view title;  ///< a counter's title
};

[[nodiscard]] const FieldInfo& field_info(Field field);
[[nodiscard]] std::size_t field_bytes(Field field);  ///< per ray
/// All of them; those of counters alone.
[[nodiscard]] std::span<const FieldInfo> field_table();
[[nodiscard]] std::span<const FieldInfo> counter_table();
/// The block that a query with many hits per ray adds: where the hits of each ray begin.
inline constexpr std::string_view splits_column = "ray_splits";
/// field_invalid, with the list of names, when unknown.
Result<Field> parse_field(std::string_view name);
/// A field, or COUNTER.LEVEL; field_invalid as parse_field(), also for a level that no scene has.
Result<Column> parse_column(std::string_view name);
[[nodiscard]] std::string column_name(const Column& column);
/// field_invalid where the column is of a level that a scene of so many levels lacks.
Result<void> check_level(const Column& column, std::uint32_t levels);

/// Gives outward normals of records; null where a primitive type has none.
using RecordNormal = void (*)(const void* record, const float point[3], float normal[3]) noexcept;

/// A sensor at the time of a ray.
struct SensorAt {
    Pose pose;
    Vec3 velocity{0};
};

/// Input of a chunk of results. Without `hits` every ray missed. `ray_of` gives the ray of each hit
/// where hits are compacted (CSR order); empty: hit i belongs to ray i. `order` gives the hit of
/// each element where answers come in another order than rays were traced; empty: element i is hit
/// i.
struct ColumnSource {
    const SceneView* scene = nullptr;
    std::span<const Ray> rays = {};
    std::span<const HitRecord> hits = {};
    std::span<const std::uint32_t> ray_of = {};
    std::span<const std::uint32_t> order = {};
    std::span<const Counters> counters = {};  ///< `counter_sets` per ray, or empty
    std::uint32_t counter_sets = 1;           ///< 1, or the levels of the scene
    RecordNormal (*record_normal)(std::uint32_t type, const void* context) = nullptr;
    const void* context = nullptr;
    const PathTable* paths = nullptr;          ///< null: user ids are those of instances
    const GeometryShading* shading = nullptr;  ///< one per geometry; null: vertices have no normals
    const Velocities* velocities = nullptr;    ///< null: the scene stands still
    std::span<const SensorAt> sensors = {};    ///< each ray's, in the order of the answers; or none
};

/// Writes an element of field_bytes() per hit (counters: per ray), canonical for misses. A counter
/// of one level needs a source with counters by level.
void write_column(const Column& column, const ColumnSource& source, std::byte* out);

/// From the world to the object of a placement, rounded once per level: for normals, and to show.
[[nodiscard]] Transform world_to_object(const SceneView& scene, std::uint64_t path);
/// Unit world normal, as column `ng`.
[[nodiscard]] Vec3 world_normal(const ColumnSource& source, const Ray& ray, const HitRecord& hit);

}  // namespace raynest

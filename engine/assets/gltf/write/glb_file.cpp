#include "engine/assets/gltf/write/glb_file.h"

#include "engine/assets/gltf/write/tables.h"
#include "engine/assets/images/image.h"
#include "engine/assets/input/import_request.h"
#include "engine/geometry/record_colours.h"
#include "engine/geometry/sphere_shape.h"
#include "engine/shading/texture_lookup.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <set>
#include <utility>

namespace raynest::gltf {
namespace {

using Json = nlohmann::json;

constexpr std::uint32_t json_chunk = 0x4E4F534A, bin_chunk = 0x004E4942;  // "JSON", "BIN\0"
constexpr std::uint64_t glb_bytes_max = std::numeric_limits<std::uint32_t>::max();
constexpr std::byte zeros[4]{};
/// Bytes of JSON of a node, and of a geometry with its attributes, at most; a name comes on top.
constexpr std::uint64_t node_bytes = 512, geometry_bytes = 2048, material_bytes = 8192;

std::vector<std::byte> bytes_of(std::string_view text) {
    std::vector<std::byte> made(text.size());
    std::memcpy(made.data(), text.data(), text.size());
    return made;
}

std::uint64_t longest_name(const char* names, std::uint64_t bytes) {
    std::uint64_t longest = 0;
    for (std::uint64_t at = 0; at < bytes;) {
        const std::uint64_t length = std::strlen(names + at);
        longest = std::max(longest, length);
        at += length + 1;
    }
    return longest;
}

std::vector<std::byte> words(std::initializer_list<std::uint32_t> values) {
    std::vector<std::byte> made(values.size() * sizeof(std::uint32_t));
    std::memcpy(made.data(), values.begin(), made.size());
    return made;
}

template <class T>
std::vector<std::byte> copied(const std::vector<T>& values) {
    const auto bytes = std::as_bytes(std::span(values));
    return {bytes.begin(), bytes.end()};
}

/// The colours of vertices as glTF has them: linear. The scene's are sRGB bytes, which 16 bits of
/// linear light give back.
std::vector<std::byte> linear_colours(const SceneView& view, const GeometryRecord& geometry) {
    const auto* const colours = view.attribute<std::uint8_t>(geometry.colours);
    const auto& linear = srgb_to_linear();
    std::vector<std::uint16_t> made(std::size_t{4} * geometry.vertex_count);
    for (std::size_t i = 0; i < made.size(); ++i)
        made[i] = i % 4 == 3
                      ? static_cast<std::uint16_t>(257 * colours[i])
                      : static_cast<std::uint16_t>(std::lround(linear[colours[i]] * 65535.0F));
    const auto bytes = std::as_bytes(std::span(made));
    return {bytes.begin(), bytes.end()};
}

}  // namespace

/// Makes the tables, and puts the file together.
class GlbWriter {
public:
    GlbWriter(const Snapshot& scene, const std::function<bool()>& stop)
        : scene_(scene),
          view_(scene.view()),
          stop_(stop) {
        tables_.ends = [this] {
            return tables_.nodes.text.size() > ImportLimits{}.json_bytes_max || stop_();
        };
        tables_.add_bytes = [this](std::span<const std::byte> bytes) { return add(bytes); };
        tables_.keep_bytes = [this](std::vector<std::byte> bytes) {
            return add(file_.made_.emplace_back(std::move(bytes)));
        };
    }

    Result<GlbFile> write() {
        if (auto done = write_materials(scene_, tables_); !done)
            return tl::unexpected(done.error());
        std::vector<std::uint32_t> mesh_of(view_.object_count, no_id);
        for (std::uint32_t i = 0; i < view_.object_count; ++i) {
            if (stop_()) return fail(ErrorCode::field_invalid, "was stopped");
            if (view_.objects[i].triangle_count != 0) mesh_of[i] = add_mesh(view_.objects[i]);
            if (view_.objects[i].record_type == primitive_type("sphere"))
                mesh_of[i] = add_spheres(view_.objects[i]);
        }
        write_nodes(scene_, mesh_of, tables_);
        if (stop_()) return fail(ErrorCode::field_invalid, "was stopped");
        warn();
        return assemble();
    }

private:
    std::uint32_t add(std::span<const std::byte> bytes) {
        const std::uint32_t index = tables_.views.add(fmt::format(
            R"({{"buffer":0,"byteOffset":{},"byteLength":{}}})", bin_bytes_, bytes.size()));
        bin_.push_back(bytes);
        const std::size_t padding = (4 - bytes.size() % 4) % 4;
        if (padding != 0) bin_.emplace_back(zeros, padding);
        bin_bytes_ += bytes.size() + padding;
        return index;
    }

    std::uint32_t accessor(std::uint64_t offset, std::uint64_t count, std::uint64_t element_bytes,
                           std::string_view kind, std::string_view more = "") {
        const std::uint32_t view = add(
            {view_.attribute<std::byte>(offset), static_cast<std::size_t>(count * element_bytes)});
        return tables_.accessors.add(
            fmt::format(R"({{"bufferView":{},"count":{},{}{}}})", view, count, kind, more));
    }

    std::uint32_t add_mesh(const ObjectRecord& object) {
        constexpr std::string_view vec2 = R"("componentType":5126,"type":"VEC2")";
        constexpr std::string_view vec3 = R"("componentType":5126,"type":"VEC3")";
        constexpr std::string_view vec4 = R"("componentType":5126,"type":"VEC4")";
        std::string list;
        for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
            const std::uint32_t index = object.first_geometry + i;
            const GeometryRecord& g = view_.geometries[index];
            if (g.triangle_count == 0) continue;
            const GeometryShading& shading = scene_.shading().geometries[index];
            const auto* const points = view_.attribute<Vec3>(g.positions);
            Vec3 lower = points[0], upper = points[0];
            for (std::uint32_t v = 1; v < g.vertex_count; ++v)
                lower = glm::min(lower, points[v]), upper = glm::max(upper, points[v]);
            std::string attributes =
                fmt::format("\"POSITION\":{}",
                            accessor(g.positions, g.vertex_count, 12, vec3,
                                     fmt::format(R"(,"min":[{},{},{}],"max":[{},{},{}])", lower.x,
                                                 lower.y, lower.z, upper.x, upper.y, upper.z)));
            const auto attribute = [&](std::string_view name, std::uint64_t offset,
                                       std::uint64_t bytes, std::string_view kind) {
                if (offset != no_offset)
                    attributes += fmt::format(",\"{}\":{}", name,
                                              accessor(offset, g.vertex_count, bytes, kind));
            };
            attribute("TEXCOORD_0", g.texcoords[0], 8, vec2);
            attribute("TEXCOORD_1", g.texcoords[1], 8, vec2);
            if (g.colours != no_offset)
                attributes += fmt::format(
                    R"(,"COLOR_0":{})",
                    add_made(linear_colours(view_, g), g.vertex_count,
                             R"("componentType":5123,"normalized":true,"type":"VEC4")"));
            attribute("NORMAL", shading.normals, 12, vec3);
            attribute("TANGENT", shading.tangents, 16, vec4);
            const std::uint32_t indices = accessor(g.indices, 3ULL * g.triangle_count, 4,
                                                   R"("componentType":5125,"type":"SCALAR")");
            list += fmt::format(R"({}{{"attributes":{{{}}},"indices":{})", list.empty() ? "" : ",",
                                attributes, indices);
            if (g.material != no_id) list += fmt::format(",\"material\":{}", g.material);
            list += '}';
        }
        return add_mesh(object, list);
    }

    std::uint32_t add_mesh(const ObjectRecord& object, std::string_view primitives) {
        std::string name;
        if (const char* text = view_.names + object.name; *text != '\0')
            name = fmt::format("\"name\":{},", json_text(text));
        return tables_.meshes.add(fmt::format(R"({{{}"primitives":[{}]}})", name, primitives));
    }

    std::uint32_t add_made(std::vector<std::byte> bytes, std::uint64_t count,
                           std::string_view kind) {
        return tables_.accessors.add(fmt::format(R"({{"bufferView":{},"count":{},{}}})",
                                                 tables_.keep_bytes(std::move(bytes)), count,
                                                 kind));
    }

    /// Adds points with an attribute of the application, `_RADIUS`.
    std::uint32_t add_spheres(const ObjectRecord& object) {
        std::vector<Vec3> centres(object.record_count);
        std::vector<float> radii(object.record_count);
        Box box;
        for (std::uint32_t i = 0; i < object.record_count; ++i) {
            Sphere sphere;
            std::memcpy(&sphere, view_.record_of(object, i), sizeof(sphere));
            centres[i] = sphere.center;
            radii[i] = sphere.radius;
            box.lower = glm::min(box.lower, sphere.center);
            box.upper = glm::max(box.upper, sphere.center);
        }
        std::string list = fmt::format(
            R"({{"mode":0,"attributes":{{"POSITION":{},"_RADIUS":{})",
            add_made(
                copied(centres), object.record_count,
                fmt::format(
                    R"("componentType":5126,"type":"VEC3","min":[{},{},{}],"max":[{},{},{}])",
                    box.lower.x, box.lower.y, box.lower.z, box.upper.x, box.upper.y, box.upper.z)),
            add_made(copied(radii), object.record_count,
                     R"("componentType":5126,"type":"SCALAR")"));
        if (record_colours(view_, object) != nullptr)
            list +=
                fmt::format(R"(,"COLOR_0":{})",
                            add_made(linear_colours(view_, view_.geometries[object.first_geometry]),
                                     object.record_count,
                                     R"("componentType":5123,"normalized":true,"type":"VEC4")"));
        return add_mesh(object, list + "}}");
    }

    /// Says what the file lacks.
    void warn() {
        for (std::size_t i = 0; i < scene_.record_types().size(); ++i)
            if (scene_.record_types()[i] == "sphere")
                tables_.warnings.push_back(fmt::format(
                    "{} spheres are written as points with _RADIUS, which raynest reads; "
                    "other programs show points",
                    scene_.record_counts()[i]));
            else
                tables_.warnings.push_back(fmt::format(
                    "{} records of type '{}' are left out: glTF has triangles and points alone",
                    scene_.record_counts()[i], scene_.record_types()[i]));
        if (tables_.meshes.count == 0)
            tables_.warnings.emplace_back(
                "the file has no mesh: there is nothing that rays can hit");
        if (!scene_.motion_bytes().empty())
            tables_.warnings.emplace_back("animations are left out");
        std::uint64_t ids = 0;
        if (scene_.paths().node_count == 0)
            for (std::uint32_t i = 0; i < view_.instance_count; ++i)
                ids += view_.instance_infos[i].uid != 0 ? 1U : 0U;
        if (ids != 0) tables_.warnings.push_back(renumbered_text(ids));
        if (scene_.origin() != WorldPoint{})
            tables_.warnings.push_back(fmt::format(
                "the coordinates of the .glb are relative to the scene's origin, {} {} {}, which a "
                ".rnscene.json keeps",
                scene_.origin()[0], scene_.origin()[1], scene_.origin()[2]));
    }

    Result<GlbFile> assemble() {
        std::string json =
            R"({"asset":{"version":"2.0","generator":"RayNest"},"scene":0,"scenes":[)";
        Json scene = Json::object();
        if (!tables_.roots.empty()) scene["nodes"] = tables_.roots;
        if (scene_.up() == UpAxis::z) scene["extras"]["raynest"]["up"] = "z";
        json += scene.dump() + ']';
        if (bin_bytes_ != 0) json += fmt::format(R"(,"buffers":[{{"byteLength":{}}}])", bin_bytes_);
        const auto table = [&json](const char* name, Rows& rows) {
            if (rows.count != 0) json += fmt::format(R"(,"{}":[{}])", name, rows.text);
            rows.text = {};
        };
        table("nodes", tables_.nodes);
        table("meshes", tables_.meshes);
        table("accessors", tables_.accessors);
        table("bufferViews", tables_.views);
        table("materials", tables_.materials);
        table("textures", tables_.textures);
        table("samplers", tables_.samplers);
        table("images", tables_.images);
        table("cameras", tables_.cameras);
        if (tables_.lights.count != 0)
            json += fmt::format(R"(,"extensions":{{"KHR_lights_punctual":{{"lights":[{}]}}}})",
                                tables_.lights.text);
        if (!tables_.extensions.empty())
            json += ",\"extensionsUsed\":" + Json(tables_.extensions).dump();
        // A reader that does not know it would show one placement of each row.
        if (tables_.extensions.contains("EXT_mesh_gpu_instancing"))
            json += R"(,"extensionsRequired":["EXT_mesh_gpu_instancing"])";
        json += '}';
        json.append((4 - json.size() % 4) % 4, ' ');
        if (json.size() > ImportLimits{}.json_bytes_max)
            return fail(ErrorCode::limit_exceeded,
                        fmt::format("its glTF would have more than {} MiB of JSON, the most that "
                                    "are read",
                                    ImportLimits{}.json_bytes_max >> 20));
        const std::uint64_t total = 12 + 8 + json.size() + (bin_bytes_ == 0 ? 0 : 8 + bin_bytes_);
        if (total > glb_bytes_max)
            return fail(
                ErrorCode::limit_exceeded,
                fmt::format("its .glb would have {} bytes; the format ends at 4 GiB", total));
        const auto whole = [](std::uint64_t bytes) { return static_cast<std::uint32_t>(bytes); };
        const auto keep = [this](std::vector<std::byte> bytes) {
            file_.add(file_.made_.emplace_back(std::move(bytes)));
        };
        keep(words({0x46546C67, 2, whole(total), whole(json.size()), json_chunk}));
        keep(bytes_of(json));
        if (bin_bytes_ != 0) keep(words({whole(bin_bytes_), bin_chunk}));
        for (const auto& bytes : bin_) file_.add(bytes);
        file_.warnings_ = std::move(tables_.warnings);
        return std::move(file_);
    }

    const Snapshot& scene_;
    const SceneView& view_;
    const std::function<bool()>& stop_;
    Tables tables_;
    GlbFile file_;
    std::vector<std::span<const std::byte>> bin_;
    std::uint64_t bin_bytes_ = 0;
};

Result<std::uint64_t> GlbFile::memory_max(const Snapshot& scene) {
    const SceneView& view = scene.view();
    const std::uint64_t nodes = expanded_nodes(scene);
    constexpr std::uint64_t most = ImportLimits{}.nodes_max;
    if (nodes > most)
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("its instances are over {} nodes, as glTF has to write them: each "
                                "node has one parent",
                                most));
    // JSON spells a byte in up to six.
    const std::uint64_t name = 6 * longest_name(view.names, scene.paths().names_bytes);
    const std::uint64_t written = nodes + scene.paths().node_count;
    const std::uint64_t json = std::min<std::uint64_t>(
        ImportLimits{}.json_bytes_max, written * (node_bytes + name) +
                                           view.geometry_count * (geometry_bytes + name) +
                                           view.material_count * (material_bytes + name));
    // The tables, the text made of them, and its bytes; a node's children and its place.
    constexpr std::uint64_t instancing_bytes = 6 * sizeof(float);
    std::uint64_t bytes = 3 * json + 32 * written + instancing_bytes * view.instance_count;
    std::set<std::uint64_t> planes;
    for (std::uint32_t i = 0; i < view.geometry_count; ++i)
        if (const GeometryRecord& g = view.geometries[i]; g.colours != no_offset)
            bytes += 3 * sizeof(std::uint16_t) * 4 * g.vertex_count;
    for (std::uint32_t i = 0; i < view.object_count; ++i)
        bytes += 3 * std::uint64_t{view.objects[i].record_count} * sizeof(Sphere);
    for (std::uint32_t i = 0; i < view.texture_count; ++i)
        if (planes.insert(view.textures[i].colour).second)
            bytes += png_bytes_max(view.textures[i].width, view.textures[i].height);
    return bytes;
}

Result<GlbFile> GlbFile::make(const Snapshot& scene, const std::function<bool()>& stop) {
    return GlbWriter(scene, stop).write();
}

void GlbFile::add(std::span<const std::byte> bytes) {
    if (bytes.empty()) return;
    ranges_.push_back({bytes_, bytes});
    bytes_ += bytes.size();
}

void GlbFile::read(std::uint64_t offset, std::span<std::byte> into) const {
    auto range = std::prev(std::ranges::upper_bound(ranges_, offset, {}, &Range::offset));
    while (!into.empty()) {
        const std::size_t skipped = offset - range->offset;
        const std::size_t count = std::min(into.size(), range->bytes.size() - skipped);
        std::memcpy(into.data(), range->bytes.data() + skipped, count);
        into = into.subspan(count);
        offset += count;
        ++range;
    }
}

std::string composition_text(const Snapshot& scene, const std::string& glb) {
    const Json origin(scene.origin());
    Json place{{"object", "scene"}};
    Json text{{"rnscene", 1}, {"objects", {{"scene", {{"file", glb}}}}}};
    if (scene.origin() != WorldPoint{}) {
        text["origin"] = origin;
        place["translation"] = origin;
    }
    if (scene.up() == UpAxis::z) text["up"] = "z";
    const SceneView& view = scene.view();
    std::set<std::uint32_t> ids;
    for (std::uint32_t i = 0; i < view.instance_count && ids.size() < 2; ++i)
        ids.insert(view.instance_infos[i].uid);
    if (scene.paths().node_count == 0 && ids.size() == 1 && *ids.begin() != 0)
        place["uid"] = *ids.begin();
    text["instances"] = Json::array({std::move(place)});
    return text.dump(2, ' ', false, Json::error_handler_t::replace) + '\n';
}

}  // namespace raynest::gltf

// Instances -> nodes, breadth first, so that the children of a node have consecutive indices.
//
// Several placements of one mesh in a row that have no names, one mask and no rotation become one
// node with EXT_mesh_gpu_instancing, which says them exactly. All others are nodes with matrices.
#include "engine/assets/gltf/write/tables.h"
#include "engine/math/matrix.h"
#include "engine/shading/types.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <iterator>
#include <map>
#include <numeric>
#include <utility>

namespace raynest::gltf {
namespace {

using Json = nlohmann::json;

constexpr std::uint32_t mask_of_all = 0xFFFFFFFFU;
/// Fewer placements in a row are shorter as nodes.
constexpr std::uint32_t row_min = 4;

/// Instances [first, first + count) of one object's list.
struct Row {
    std::uint32_t first = 0;
    std::uint32_t count = 0;
};

bool is_scaled_only(const Transform& t) {
    for (const std::size_t i : {1U, 2U, 4U, 6U, 8U, 9U})
        if (t.m[i] != 0) return false;
    return true;
}

/// Splits an object's instances into rows of one node each.
std::vector<Row> rows_of(const Snapshot& scene, const ObjectRecord& object) {
    const SceneView& view = scene.view();
    // Names of paths tell placements apart.
    const bool may_join = scene.paths().node_count == 0;
    std::vector<Row> rows;
    const std::uint32_t end = object.first_instance + object.instance_count;
    for (std::uint32_t i = object.first_instance; i < end;) {
        const InstanceRecord& head = view.instances[i];
        const auto joins = [&](std::uint32_t k) {
            const InstanceRecord& other = view.instances[k];
            const InstanceInfo& info = view.instance_infos[k];
            return other.object == head.object && info.mask == view.instance_infos[i].mask &&
                   view.names[info.name] == '\0' && is_scaled_only(info.to_parent);
        };
        std::uint32_t next = i;
        if (may_join && view.objects[head.object].instance_count == 0)
            while (next < end && joins(next)) ++next;
        if (next - i < row_min) next = i + 1;
        rows.push_back({i, next - i});
        i = next;
    }
    return rows;
}

class NodeWriter {
public:
    NodeWriter(const Snapshot& scene, std::span<const std::uint32_t> mesh_of, Tables& tables)
        : scene_(scene),
          view_(scene.view()),
          mesh_of_(mesh_of),
          tables_(tables),
          rows_(view_.object_count) {}

    void write() {
        for (std::uint32_t i = 0; i < view_.object_count; ++i)
            rows_[i] = rows_of(scene_, view_.objects[i]);
        const ObjectRecord& root = view_.objects[view_.root];
        std::uint32_t roots = static_cast<std::uint32_t>(rows_[view_.root].size());
        if (root.has_own_primitives()) ++roots;
        tables_.roots.resize(roots);
        std::iota(tables_.roots.begin(), tables_.roots.end(), 0U);
        next_ = roots;
        if (root.has_own_primitives()) tables_.nodes.add(own_primitives_of_root());
        add_children({view_.root, 0, mask_of_all});
        for (std::size_t i = 0; i < queue_.size() && !tables_.ends(); ++i)
            add_children(Open(queue_[i]));
        if (scene_.paths().node_count != 0) {
            tables_.warnings.emplace_back(
                "names above shared parts are left out: paths have those of the parts alone");
            tables_.warnings.push_back(renumbered_text(view_.objects[view_.root].placement_count));
        }
        if (crossed_masks_ != 0)
            tables_.warnings.push_back(fmt::format(
                "{} placements lie in instances with several masks: the file has the bits that all "
                "of them have",
                crossed_masks_));
    }

private:
    std::string own_primitives_of_root() const {
        const std::uint32_t mesh = mesh_of_[view_.root];
        if (mesh == no_id) return "{}";
        std::string node = fmt::format("{{\"mesh\":{}", mesh);
        if (scene_.up() != UpAxis::y) node += ",\"matrix\":" + matrix_text(turned(scene_, {}));
        return node + '}';
    }

    /// A node whose children are not written yet.
    struct Open {
        std::uint32_t object;
        std::uint64_t path;  ///< its first placement's
        std::uint32_t mask;  ///< for the way down to it
    };

    void add_children(const Open& open) {
        for (const Row& row : rows_[open.object]) {
            if (tables_.ends()) return;
            const InstanceRecord& instance = view_.instances[row.first];
            const ObjectRecord& child = view_.objects[instance.object];
            const std::uint64_t path = open.path + instance.path_base;
            const std::uint32_t own = view_.instance_infos[row.first].mask;
            std::uint32_t mask = open.mask & own;
            if (open.mask != mask_of_all && own != mask_of_all && open.mask != own)
                ++crossed_masks_;
            std::string node;
            const auto member = [&node](std::string_view text) {
                node += node.empty() ? '{' : ',';
                node += text;
            };
            const std::uint32_t mesh = mesh_of_[instance.object];
            if (const std::string name = name_of(row.first, child, path, mesh != no_id);
                !name.empty())
                member("\"name\":" + json_text(name));
            if (mesh != no_id) member(fmt::format("\"mesh\":{}", mesh));
            Transform t;
            if (row.count > 1)
                member(instancing(row));
            else
                t = view_.instance_infos[row.first].to_parent;
            if (open.object == view_.root) t = turned(scene_, t);
            if (t.m != Transform{}.m) member("\"matrix\":" + matrix_text(t));
            if (mask != mask_of_all)
                member(fmt::format(R"("extras":{{"raynest":{{"mask":{}}}}})", mask));
            if (const auto count = rows_[instance.object].size(); count != 0) {
                std::string list;
                for (std::size_t k = 0; k < count; ++k)
                    fmt::format_to(std::back_inserter(list), "{}{}", k == 0 ? "" : ",", next_ + k);
                next_ += static_cast<std::uint32_t>(count);
                member("\"children\":[" + list + ']');
                queue_.push_back({instance.object, path, mask});
            }
            tables_.nodes.add(node.empty() ? "{}" : node + '}');
        }
    }

    /// The name that a path text shows. A node with a mesh has that of its mesh where it has none.
    std::string name_of(std::uint32_t instance, const ObjectRecord& child, std::uint64_t path,
                        bool has_mesh) const {
        const PathTable& paths = scene_.paths();
        if (paths.node_count != 0)
            return child.has_own_primitives()
                       ? node_name(view_.names + paths.nodes[paths.run_of(path).node].name)
                       : std::string();
        const char* const own = view_.names + view_.instance_infos[instance].name;
        return *own != '\0' || has_mesh ? node_name(own) : std::string(view_.names + child.name);
    }

    /// All that place the row's object share its bytes.
    const std::string& instancing(const Row& row) {
        std::string& known = instancings_[row.first];
        if (known.empty()) known = write_instancing(row);
        return known;
    }

    std::string write_instancing(const Row& row) {
        std::vector<std::byte> offsets(row.count * 3 * sizeof(float));
        std::vector<std::byte> scales(offsets.size());
        for (std::uint32_t k = 0; k < row.count; ++k) {
            const Transform& t = view_.instance_infos[row.first + k].to_parent;
            const float offset[3]{t.m[3], t.m[7], t.m[11]};
            const float scale[3]{t.m[0], t.m[5], t.m[10]};
            std::memcpy(offsets.data() + k * sizeof offset, offset, sizeof offset);
            std::memcpy(scales.data() + k * sizeof scale, scale, sizeof scale);
        }
        const auto accessor = [&](std::vector<std::byte> bytes) {
            return tables_.accessors.add(
                fmt::format(R"({{"bufferView":{},"componentType":5126,"count":{},"type":"VEC3"}})",
                            tables_.keep_bytes(std::move(bytes)), row.count));
        };
        tables_.extensions.insert("EXT_mesh_gpu_instancing");
        const std::uint32_t translation = accessor(std::move(offsets));
        const std::uint32_t scale = accessor(std::move(scales));
        return fmt::format(R"("extensions":{{"EXT_mesh_gpu_instancing":{{"attributes":)"
                           R"({{"TRANSLATION":{},"SCALE":{}}}}}}})",
                           translation, scale);
    }

    const Snapshot& scene_;
    const SceneView& view_;
    std::span<const std::uint32_t> mesh_of_;
    Tables& tables_;
    std::vector<std::vector<Row>> rows_;                ///< by object
    std::map<std::uint32_t, std::string> instancings_;  ///< by the first instance of a row
    std::vector<Open> queue_;
    std::uint32_t next_ = 0;
    std::uint64_t crossed_masks_ = 0;
};

/// The pose of something that looks along `direction`.
Transform facing(const Vec3& position, const Vec3& direction) {
    const glm::dvec3 z = -glm::dvec3(direction);
    const glm::dvec3 side = std::abs(z.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0);
    const glm::dvec3 x = glm::normalize(glm::cross(side, z));
    const glm::dvec3 y = glm::cross(z, x);
    Transform made;
    for (int r = 0; r < 3; ++r) {
        const auto row = static_cast<std::size_t>(4 * r);
        made.m[row] = static_cast<float>(x[r]);
        made.m[row + 1] = static_cast<float>(y[r]);
        made.m[row + 2] = static_cast<float>(z[r]);
        made.m[row + 3] = position[r];
    }
    return made;
}

void write_cameras(const Snapshot& scene, Tables& tables) {
    const SceneView& view = scene.view();
    for (std::uint32_t i = 0; i < view.camera_count; ++i) {
        const CameraRecord& camera = view.cameras[i];
        const double aspect = camera.aspect > 0 ? double{camera.aspect} : 1.0;
        Json row;
        if (camera.ymag > 0) {
            row = {{"type", "orthographic"},
                   {"orthographic",
                    {{"xmag", double{camera.ymag} * aspect},
                     {"ymag", camera.ymag},
                     {"znear", 0},
                     {"zfar", 1e6}}}};
        } else {
            row = {{"type", "perspective"},
                   {"perspective", {{"yfov", camera.yfov}, {"znear", 0.01}}}};
            if (camera.aspect > 0) row["perspective"]["aspectRatio"] = camera.aspect;
        }
        const std::uint32_t index = tables.cameras.add(row.dump());
        tables.roots.push_back(tables.nodes.add(fmt::format(
            R"({{"name":{},"camera":{},"matrix":{}}})", json_text(view.names + camera.name), index,
            matrix_text(turned(scene, camera.to_world)))));
    }
}

void write_lights(const Snapshot& scene, Tables& tables) {
    const ShadingView& shading = scene.shading();
    if (shading.light_count != 0) tables.extensions.insert("KHR_lights_punctual");
    std::uint64_t unknown = 0, own = 0;
    for (std::uint32_t i = 0; i < shading.light_count; ++i) {
        const LightRecord& light = shading.lights[i];
        const char* const kind = light_name(light.kind);
        if (kind == nullptr) {
            ++unknown;
            continue;
        }
        constexpr std::array types{"point", "spot", "directional"};
        const bool is_own = std::ranges::find(types, std::string_view(kind)) == types.end();
        const float most = std::max({light.intensity.x, light.intensity.y, light.intensity.z});
        const float scale = most > 0 ? std::exp2(std::ceil(std::log2(most))) : 1.0F;
        const Vec3 colour = light.intensity / scale;
        Json row{{"type", is_own ? "point" : kind},
                 {"intensity", scale},
                 {"color", {colour.x, colour.y, colour.z}}};
        if (light.range > 0) row["range"] = light.range;
        if (light.kind == shading_type("spot"))
            row["spot"] = {{"innerConeAngle", std::acos(double{light.own[0]})},
                           {"outerConeAngle", std::acos(double{light.own[1]})}};
        if (is_own) {
            Json& extras = row["extras"]["raynest"] = {{"light", kind}};
            const auto numbers = light_numbers(light.kind);
            for (std::size_t n = 0; n < numbers.size(); ++n) extras[numbers[n].name] = light.own[n];
            ++own;
        }
        const std::uint32_t index = tables.lights.add(row.dump());
        tables.roots.push_back(tables.nodes.add(fmt::format(
            R"({{"name":{},"matrix":{},"extensions":{{"KHR_lights_punctual":{{"light":{}}}}}}})",
            json_text(scene.view().names + light.name),
            matrix_text(turned(scene, facing(light.position, light.direction))), index)));
    }
    if (unknown != 0)
        tables.warnings.push_back(
            fmt::format("{} lights of kinds that this build lacks are left out", unknown));
    if (own != 0)
        tables.warnings.push_back(fmt::format(
            "{} lights are of kinds that glTF does not know: to other programs they are points",
            own));
}

}  // namespace

std::string json_text(std::string_view name) {
    return Json(name).dump(-1, ' ', false, Json::error_handler_t::replace);
}

Transform turned(const Snapshot& scene, const Transform& to_scene) {
    return scene.up() == UpAxis::y
               ? to_scene
               : transform_of(turn_of(scene.up(), UpAxis::y) * matrix_of(to_scene));
}

std::string matrix_text(const Transform& t) {
    std::string text = "[";
    for (std::size_t i = 0; i < 16; ++i)
        fmt::format_to(std::back_inserter(text), "{}{}", i == 0 ? "" : ",",
                       i % 4 == 3 ? (i == 15 ? 1.0F : 0.0F) : t.m[4 * (i % 4) + i / 4]);
    return text + ']';
}

std::string node_name(std::string_view step) {
    std::string made;
    const auto digit = [](char c) { return c <= '9' ? c - '0' : (c & 7) + 9; };
    for (std::size_t i = 0; i < step.size(); ++i) {
        if (step[i] != '%' || i + 2 >= step.size()) {
            made += step[i];
            continue;
        }
        made += static_cast<char>(16 * digit(step[i + 1]) + digit(step[i + 2]));
        i += 2;
    }
    return made;
}

std::uint64_t expanded_nodes(const Snapshot& scene) {
    constexpr std::uint64_t most = 1ULL << 62;
    const SceneView& view = scene.view();
    std::vector<std::uint64_t> below(view.object_count, 0);
    for (std::uint32_t i = 0; i < view.object_count; ++i)
        for (const Row& row : rows_of(scene, view.objects[i]))
            below[i] = std::min(most, below[i] + 1 + below[view.instances[row.first].object]);
    return below[view.root];
}

void write_nodes(const Snapshot& scene, std::span<const std::uint32_t> mesh_of, Tables& tables) {
    if (!write_path_nodes(scene, mesh_of, tables)) NodeWriter(scene, mesh_of, tables).write();
    write_cameras(scene, tables);
    write_lights(scene, tables);
}

}  // namespace raynest::gltf

// PARTS: lists the meshes or materials of a scene, a page at a time.
#include "engine/scene/snapshot.h"
#include "protocol/text.h"
#include "server/documents/scene_info.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <array>

namespace raynest::server {
namespace {

/// Parts per page; a page of the longest names is far below control_bytes_max.
constexpr std::size_t page_parts = 128;
/// glTF's names, in the order of AlphaMode.
constexpr std::array<const char*, 3> alpha_modes = {"OPAQUE", "MASK", "BLEND"};

void add_mesh(const SceneView& view, const MeshUse& mesh, std::size_t name_bytes,
              wire::PartListT& list) {
    const ObjectRecord& object = view.objects[mesh.object];
    list.names.push_back(protocol::clean_text(view.names + object.name, name_bytes));
    list.triangles.push_back(object.triangle_count);
    list.records.push_back(object.record_count);
    list.placements.push_back(mesh.placements);
    list.alpha_modes.emplace_back();
}

void add_material(const SceneView& view, std::size_t index, const MaterialUse& use,
                  std::size_t name_bytes, wire::PartListT& list) {
    const MaterialRecord& material = view.materials[index];
    list.names.push_back(protocol::clean_text(view.names + material.name, name_bytes));
    list.triangles.push_back(use.triangles);
    list.records.push_back(0);
    list.placements.push_back(use.placements);
    list.alpha_modes.emplace_back(alpha_modes[static_cast<std::size_t>(material.alpha_mode)]);
}

}  // namespace

Reply<Answer> parts(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Parts>& message) {
    const std::string_view kind = protocol::text(message->kind());
    if (kind != "meshes" && kind != "materials")
        return refuse(Code::invalid_field, "unknown kind '" + std::string(kind) +
                                               "' of parts: use one of meshes, materials");
    const auto scene =
        services.scenes.find_to_read(protocol::text(message->scene()), message->epoch(), caller);
    if (!scene) return tl::unexpected(scene.error());
    const Snapshot& snapshot = scene->snapshot();
    const std::size_t total =
        kind == "meshes" ? snapshot.meshes().size() : snapshot.material_uses().size();
    const std::size_t first = std::min<std::size_t>(message->first(), total);
    const std::size_t last = std::min(total, first + page_parts);

    wire::PartListT list;
    list.first = static_cast<std::uint32_t>(first);
    list.total = static_cast<std::uint32_t>(total);
    const std::size_t name_bytes = services.limits.name_bytes_max;
    for (std::size_t i = first; i < last; ++i) {
        if (kind == "meshes")
            add_mesh(snapshot.view(), snapshot.meshes()[i], name_bytes, list);
        else
            add_material(snapshot.view(), i, snapshot.material_uses()[i], name_bytes, list);
    }
    return answer_with(caller, list, services);
}

}  // namespace raynest::server

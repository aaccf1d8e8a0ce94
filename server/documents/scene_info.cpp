#include "server/documents/scene_info.h"

#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"
#include "engine/scene/edits/pose.h"
#include "protocol/text.h"

namespace raynest::server {
namespace {

/// Maximum bytes of all strings of the message; leaves room for the overhead of FlatBuffers.
constexpr std::size_t text_bytes_max = 32 << 10;

/// Fills lists of a message until text_bytes_max are used up.
class TextBudget {
public:
    explicit TextBudget(const protocol::Limits& limits) : limits_(limits) {}

    /// Appends a cleaned copy; false when the list or the message is full.
    bool append(std::vector<std::string>& list, std::string_view text, std::size_t bytes_max) {
        std::string clean = protocol::clean_text(text, bytes_max);
        constexpr std::size_t overhead = 16;
        const std::size_t cost = clean.size() + overhead;
        // Keep one place of every list for the line that counts the missing items.
        if (cost > left_ || list.size() + 1 >= limits_.list_items_max) return false;
        left_ -= cost;
        list.push_back(std::move(clean));
        return true;
    }

private:
    const protocol::Limits& limits_;
    std::size_t left_ = text_bytes_max;
};

void note_missing(wire::SceneInfoT& info, std::size_t shown, std::size_t total, const char* what) {
    if (shown < total)
        info.warnings.push_back(std::to_string(total - shown) + " more " + what + " not listed");
}

}  // namespace

wire::SceneInfoT scene_info(const NamedScene& scene, const Registry& registry,
                            const protocol::Limits& limits) {
    const Snapshot& snapshot = scene.snapshot();
    const SceneStatistics& statistics = snapshot.statistics();
    wire::SceneInfoT info;
    info.name = scene.name;
    info.hash = snapshot.digest();
    info.epoch = scene.epoch;
    info.unique_triangles = statistics.unique_triangles;
    info.instanced_triangles = statistics.instanced_triangles;
    info.instances = statistics.instances;
    info.levels = statistics.levels;
    if (const auto chosen = registry.choose("auto", snapshot.view()))
        info.intersector = protocol::clean_text((*chosen)->name, limits.name_bytes_max);
    info.materials = statistics.materials;
    info.mask_materials = statistics.mask_materials;
    info.blend_materials = snapshot.view().blended_materials;
    info.meshes = static_cast<std::uint32_t>(snapshot.meshes().size());
    info.bytes = statistics.bytes;
    info.build = build_quality_names[static_cast<std::size_t>(statistics.build)];
    info.build_seconds = scene.build_seconds;
    info.sah_cost = statistics.trees.sah_cost;
    info.tree_height = statistics.trees.height;
    info.nodes = statistics.nodes;
    info.leaf_blocks = statistics.leaf_blocks;
    info.tree_bytes =
        statistics.nodes * sizeof(Node) + statistics.leaf_blocks * sizeof(TriangleBlock);
    const auto vector = [](const Vec3& v) { return std::make_unique<wire::Vec3>(v.x, v.y, v.z); };
    info.box_min = vector(snapshot.bounds().lower);
    info.box_max = vector(snapshot.bounds().upper);

    info.origin_x = snapshot.origin()[0];
    info.origin_y = snapshot.origin()[1];
    info.origin_z = snapshot.origin()[2];
    info.up = snapshot.up() == UpAxis::z ? "z" : "y";
    info.variant = protocol::clean_text(statistics.chosen_variant, limits.name_bytes_max);
    info.degenerate_triangles = statistics.degenerate_triangles;
    info.refits = statistics.edits.refits;
    info.rebuilds = statistics.edits.rebuilds;
    info.kept = scene.kept;
    info.last_edit = protocol::clean_text(scene.last_edit, limits.text_bytes_max);

    TextBudget texts(limits);
    for (const auto& [reason, count] : statistics.skipped)
        if (texts.append(info.skipped_reasons, reason, limits.name_bytes_max))
            info.skipped_counts.push_back(count);
    for (std::size_t i = 0; i < snapshot.record_types().size(); ++i)
        if (texts.append(info.record_types, snapshot.record_types()[i], limits.name_bytes_max))
            info.record_counts.push_back(snapshot.record_counts()[i]);
    for (const std::string& camera : statistics.cameras)
        if (!texts.append(info.cameras, camera, limits.name_bytes_max)) break;
    for (const SceneAnimation& animation : animations_of(snapshot, limits.list_items_max)) {
        if (!texts.append(info.animations, animation.name, limits.name_bytes_max)) break;
        info.animation_seconds.push_back(animation.seconds);
    }
    for (const std::string& variant : statistics.variants)
        if (!texts.append(info.variants, variant, limits.name_bytes_max)) break;
    for (const std::string& warning : statistics.warnings)
        if (!texts.append(info.warnings, warning, limits.text_bytes_max)) break;
    const std::size_t warnings = info.warnings.size();
    note_missing(info, warnings, statistics.warnings.size(), "warnings are");
    note_missing(info, info.variants.size(), statistics.variants.size(), "variants are");
    note_missing(info, info.cameras.size(), statistics.cameras.size(), "cameras are");
    return info;
}

}  // namespace raynest::server

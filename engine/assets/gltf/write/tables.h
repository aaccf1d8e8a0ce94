// The tables of a glTF file while it is written: rows of JSON as text, for scenes have millions.
#pragma once

#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <nlohmann/json.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::gltf {

/// A list of JSON values.
struct Rows {
    std::string text;
    std::uint32_t count = 0;

    /// Adds a row, and returns its index.
    std::uint32_t add(std::string_view row) {
        if (count != 0) text += ',';
        text += row;
        return count++;
    }
};

struct Tables {
    Rows nodes, meshes, accessors, views, materials, textures, images, samplers, cameras, lights;
    std::vector<std::uint32_t> roots;
    std::set<std::string> extensions;
    std::vector<std::string> warnings;
    /// True once nobody needs the file, or it has more nodes than any.
    std::function<bool()> ends;
    /// Adds bytes to the BIN chunk at a multiple of 4, and returns the index of their bufferView.
    std::function<std::uint32_t(std::span<const std::byte>)> add_bytes;
    /// The same for bytes that only the caller has.
    std::function<std::uint32_t(std::vector<std::byte>)> keep_bytes;
};

/// A JSON text of a name; bytes that are no UTF-8 are replaced.
[[nodiscard]] std::string json_text(std::string_view name);

/// A transform to a scene's space, to where that is with glTF's +Y up. Exact.
[[nodiscard]] Transform turned(const Snapshot& scene, const Transform& to_scene);
/// The members of a node's `matrix`.
[[nodiscard]] std::string matrix_text(const Transform& transform);
/// A step of a path text, without its percent-encoding.
[[nodiscard]] std::string node_name(std::string_view step);

/// Writes materials, textures and pictures; material i is that of the scene.
Result<void> write_materials(const Snapshot& scene, Tables& tables);

/// Returns how many nodes the scene's instances are written as; saturates.
[[nodiscard]] std::uint64_t expanded_nodes(const Snapshot& scene);
/// Writes nodes, cameras and lights, some of the nodes where `ends` says so. `mesh_of` has the mesh of each object, or no_id.
void write_nodes(const Snapshot& scene, std::span<const std::uint32_t> mesh_of, Tables& tables);

/// Says that so many instances will have other user ids.
[[nodiscard]] std::string renumbered_text(std::uint64_t count);

/// Writes the nodes of a scene that was read from a tree of nodes, if all of its placements lie in
/// its root; else writes nothing and returns false.
bool write_path_nodes(const Snapshot& scene, std::span<const std::uint32_t> mesh_of,
                      Tables& tables);

}  // namespace raynest::gltf

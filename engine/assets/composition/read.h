// A *.rnscene.json: what it says, before its files are read. FORMAT.md describes the text, and
// composition.schema.json says it to editors.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/math/matrix.h"
#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::composition {

/// An object of the scene at one or more places.
struct Places {
    std::string object;
    std::string name;              ///< its step in path texts
    std::vector<Matrix> matrices;  ///< from the object's space to that of the group
    std::string table;             ///< a .npy of matrices in place of these
    std::uint32_t mask = 0xFFFFFFFFU;
    std::uint32_t uid = no_id;  ///< the column `uid` of its hits; no_id: none
};

/// A file, a built-in scene, or a group of instances.
struct Object {
    std::string name;
    std::string source;  ///< as the file spells it; empty: a group
    std::string primitive;
    FileOptions options;
    WorldPoint origin{};
    std::vector<std::string> masks;
    std::string variant;            ///< of KHR_materials_variants
    std::vector<Places> instances;  ///< of a group
};

/// A camera in the world, before the origin is subtracted.
struct Camera {
    std::string name;
    glm::dvec3 eye{0}, target{0}, up{0, 1, 0};
    double fov = 40;  ///< degrees, vertical
};

/// A light in the world, before the origin is subtracted.
struct Light {
    std::string name;
    glm::dvec3 position{0};
    LightRecord record;  ///< all but its position
};

struct Composition {
    WorldPoint origin{};
    std::vector<Object> objects;  ///< the last one is the scene itself, a group
    std::vector<Camera> cameras;
    std::vector<Light> lights;
};

/// Reads the text. scene_invalid, with the place and the remedy: no JSON, nested too deeply, a
/// member that is unknown, twice there, of the wrong type or not finite, and an object that is not
/// there. limit_exceeded: over nodes_max instances.
Result<Composition> read(std::string_view text, const ImportLimits& limits);

}  // namespace raynest::composition

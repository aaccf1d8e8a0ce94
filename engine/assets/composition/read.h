// A *.rnscene.json: what it says, before its files are read. FORMAT.md describes the text, and
// composition.schema.json says it to editors.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/math/matrix.h"
#include "engine/result.h"
#include "engine/scene/description.h"
#include "engine/scene/edits/batch.h"
#include "engine/scene/motion/motion.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::composition {

/// As in glTF: scaled, then turned by a quaternion x, y, z, w, then moved.
struct PoseParts {
    glm::dvec3 translation{0};
    std::array<double, 4> rotation{0, 0, 0, 1};
    glm::dvec3 scale{1};
};

/// An object of the scene at one or more places.
struct Places {
    std::string object;
    std::string name;                ///< its step in path texts
    std::vector<Matrix> matrices;    ///< from the object's space to that of the group
    std::optional<PoseParts> parts;  ///< set if no matrix places the part
    std::string table;               ///< a .npy of matrices in place of these
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
    WorldPoint at{};  ///< where the zero of the file's coordinates lies; then `origin` is zero
    std::vector<std::string> masks;
    std::string variant;            ///< a variant by KHR_materials_variants
    std::string mesh;               ///< as in ImportRequest
    bool has_up = false;            ///< options.z_up was given
    std::vector<Places> instances;  ///< a group's content

    /// How many instances have each name. Where they are several, each has a number.
    [[nodiscard]] std::map<std::string_view, std::size_t> entries_by_name() const {
        std::map<std::string_view, std::size_t> counts;
        for (const Places& places : instances) ++counts[places.name];
        return counts;
    }
};

/// A camera in the world, before the origin is subtracted.
struct Camera {
    std::string name;
    glm::dvec3 eye{0}, target{0}, up{0};
    double fov = 40;  ///< degrees, vertical
};

/// A light in the world, before the origin is subtracted.
struct Light {
    std::string name;
    glm::dvec3 position{0};
    LightRecord record;  ///< all but its position
};

/// A change of what the instances place, as `raynest edit` makes it.
struct Change {
    enum class What : std::uint8_t { move, place, set_mask, set_uid, set_material, remove };
    What what = What::move;
    std::string path;                    ///< as InstanceFinder::find() takes it
    EditFrame frame = EditFrame::world;  ///< `matrix` is in this frame
    Matrix matrix{1};                    ///< for move and place
    std::uint32_t value = 0;             ///< for set_mask and set_uid
    std::string material;                ///< for set_material, as find_material() takes it
};

/// Keys of a part of where an instance stands, as those of a node in glTF.
struct Channel {
    std::string place;     ///< in the text
    std::string instance;  ///< the name of an outermost one, "car#1" of several
    MotionPath path = MotionPath::translation;
    Interpolation interpolation = Interpolation::linear;
    std::vector<float> times;   ///< seconds, ascending
    std::vector<float> values;  ///< 3 of each key, of rotations 4; cubic keys have 3 times as many
};

struct Animation {
    std::string name;
    std::vector<Channel> channels;
};

struct Composition {
    WorldPoint origin{};
    UpAxis up = UpAxis::y;
    std::vector<Object> objects;  ///< the last one is the scene itself, a group
    std::vector<Camera> cameras;
    std::vector<Light> lights;
    std::vector<Animation> animations;
    std::vector<Change> edits;
};

/// Reads the text. scene_invalid, with the place and the remedy: no JSON, nested too deeply, a
/// member that is unknown, twice there, of the wrong type or not finite, and an object that is not
/// there. limit_exceeded: over nodes_max instances.
Result<Composition> read(std::string_view text, const ImportLimits& limits);

}  // namespace raynest::composition

// The identity of a scene: a 256-bit digest of what it consists of. Trees, boxes and the order of
// records in the arena are left out, so an edited scene has the digest of the same content loaded
// afresh. FORMAT.md says what is hashed (Identity).
//
// Digests form a tree as the scene does: an object's is made of its primitives and of its
// instances, hashed in runs, and an instance brings the digest of its object. So an edit hashes
// the runs and objects on its way to the root again, and nothing else; and it makes no difference
// which objects are shared.
#pragma once

#include "engine/scene/digest.h"
#include "engine/shading/records.h"

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace raynest {

/// An arena that was checked, and its views.
struct CheckedArena {
    std::span<const std::byte> bytes;
    const SceneView& view;
    const ShadingView& shading;
};

/// The changes of one object by an edit.
struct TouchedObject {
    bool primitives = false;            ///< its vertices or materials
    std::vector<std::uint32_t> places;  ///< its instances that change, or lead to such
};
/// By object. An object above a touched one is touched itself, up to the root.
using TouchedObjects = std::map<std::uint32_t, TouchedObject>;

/// Immutable, so that scenes may share it.
class ContentDigests {
public:
    /// Hashes a whole scene, on all threads. Fails with `internal` as scene_digest() does, and with
    /// scene_invalid where vertices of several meshes overlap in the arena: hashing them could take
    /// for ever.
    static Result<std::shared_ptr<const ContentDigests>> of(const CheckedArena& scene);

    /// Hashes what an edit has touched in a scene of these digests. Cameras are always hashed.
    [[nodiscard]] Result<std::shared_ptr<const ContentDigests>> after(
        const CheckedArena& edited, const TouchedObjects& touched) const;

    /// 64 lower-case hex digits.
    [[nodiscard]] const std::string& scene() const { return scene_; }

private:
    struct ObjectDigests {
        Sha256 primitives{};
        std::vector<Sha256> runs;       ///< one for each run of instances
        std::vector<Sha256> long_runs;  ///< one for each run of runs, where there are many
        Sha256 whole{};
    };
    [[nodiscard]] const ObjectDigests& at(std::uint32_t object) const {
        const auto found = changed_.find(object);
        return found == changed_.end() ? (*opened_)[object] : *found->second;
    }
    class Hasher;
    Result<void> set_scene(const CheckedArena& scene);

    std::shared_ptr<const std::vector<Sha256>> materials_;
    std::shared_ptr<const std::vector<ObjectDigests>> opened_;
    std::map<std::uint32_t, std::shared_ptr<const ObjectDigests>> changed_;  ///< by edits since
    Sha256 rest_{};  ///< digest of what no edit changes in place
    std::string scene_;
};

}  // namespace raynest

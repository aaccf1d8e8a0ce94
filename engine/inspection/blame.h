// Which instances, meshes and materials the rays of a picture spend their work on.
//
//   kernel with an observer ──Step──► BlameCollector, one per chunk ──► Blame, one per picture
//
// Work is boxes and primitives tested. That of a tree belongs to the innermost instance that is
// walked, or with a level to the instance around it there; what lies above is the remainder. Sums
// are integers, so that neither threads nor chunks change them.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/inspection/descent.h"
#include "engine/inspection/names.h"
#include "engine/integrators/picture.h"
#include "engine/packs/observer.h"
#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <mutex>
#include <optional>
#include <unordered_map>
#include <vector>

namespace raynest {

/// The work of all rays together in a row's trees or primitives.
struct BlamedWork {
    std::uint64_t boxes = 0;
    std::uint64_t prims = 0;
    std::uint64_t wasted = 0;      ///< boxes and primitives of rays that hit nothing in it
    std::uint64_t rays = 0;        ///< that entered it; of a material, tested its primitives
    std::uint64_t hit_rays = 0;    ///< those with their nearest hit in it
    std::uint64_t candidates = 0;  ///< hits that the intersector judged
    std::uint64_t refused = 0;     ///< those that it refused
    /// Instances in its own tree that were entered by rays whose hit lies in one of them, and those
    /// that held the hit.
    std::uint64_t entered = 0;
    std::uint64_t needed = 0;

    [[nodiscard]] std::uint64_t work() const { return boxes + prims; }
    void add(const BlamedWork& other);
};

/// An instance by its placements and how deep it lies; a mesh by its object; a material by its
/// index, or no_id.
struct BlameKey {
    PlacementRange placements;
    std::uint32_t depth = 0;
    std::uint32_t index = 0;  ///< object or material
    bool operator==(const BlameKey&) const = default;
};
struct BlameKeyHash {
    std::size_t operator()(const BlameKey& key) const noexcept;
};

enum class BlameTable : std::uint32_t { instances, meshes, materials };
inline constexpr std::size_t blame_tables = 3;

using BlameRows = std::unordered_map<BlameKey, BlamedWork, BlameKeyHash>;

/// Groups by the innermost instance.
inline constexpr std::uint32_t innermost_level = 0;

class Blame {
public:
    /// `level` is that of the trees that instances open: 1 for those of the root. At most
    /// `rows_max` rows are kept.
    Blame(const Snapshot& scene, std::uint32_t level, std::size_t rows_max)
        : scene_(scene),
          level_(level),
          rows_max_(rows_max) {}

    [[nodiscard]] const Snapshot& scene() const { return scene_; }
    [[nodiscard]] std::uint32_t level() const { return level_; }
    [[nodiscard]] const BlameRows& rows(BlameTable table) const {
        return rows_[static_cast<std::size_t>(table)];
    }
    [[nodiscard]] std::uint64_t rays() const { return total_.rays; }
    /// All work, that of no row included.
    [[nodiscard]] const BlamedWork& total() const { return total_; }
    /// True if there were more rows than may be kept: the others mean nothing then.
    [[nodiscard]] bool overflowed() const { return overflowed_; }

    /// Adds a row's work. Only within with_lock().
    void add(BlameTable table, const BlameKey& key, const BlamedWork& work);
    void add_total(const BlamedWork& work) { total_.add(work); }
    /// Calls f() while no other thread adds rows.
    template <class F>
    void with_lock(F&& f) {
        const std::lock_guard lock(mutex_);
        f();
    }

private:
    const Snapshot& scene_;
    const std::uint32_t level_;
    const std::size_t rows_max_;
    std::mutex mutex_;
    BlameRows rows_[blame_tables];
    BlamedWork total_;
    bool overflowed_ = false;
};

/// Traces the rays of pixels before an observer. Nothing where the caster has no answers.
[[nodiscard]] std::optional<CameraHits> watch_rays(const PixelRange& pixels, RayCaster& caster,
                                                   const PixelArrays& arrays,
                                                   const Observer& observer);

/// Watches the rays of one chunk, on one thread.
class BlameCollector {
public:
    explicit BlameCollector(Blame& blame);
    BlameCollector(const BlameCollector&) = delete;

    [[nodiscard]] const Observer& observer() const { return observer_; }
    /// Hands all that was collected to the Blame. Throws std::bad_alloc if memory ran out while
    /// rays were watched.
    void finish();

private:
    /// The rays' work in a row since it was last handed on; `ray` is that of the present one.
    struct Row {
        BlameKey key;
        BlamedWork sum;
        BlamedWork ray;
        bool touched = false;
    };
    class Rows {
    public:
        /// Returns the row's number, which lasts until clear(). The present ray has entered it.
        std::uint32_t touch(const BlameKey& key);
        [[nodiscard]] BlamedWork& ray_in(std::uint32_t row) { return rows_[row].ray; }
        /// The present ray has ended. `contains(key)` tells whether its hit lies in the row.
        template <class Contains>
        void end_ray(Contains&& contains);
        void clear();
        [[nodiscard]] const std::vector<Row>& all() const { return rows_; }

    private:
        std::unordered_map<BlameKey, std::uint32_t, BlameKeyHash> numbers_;
        std::vector<Row> rows_;
        std::vector<std::uint32_t> touched_;
    };
    struct Level {
        std::uint32_t object = 0;
        std::uint32_t instance = no_id;
        std::uint32_t group = no_id;  ///< row of the instances; no_id: above all groups
        std::uint32_t mesh = no_id;
    };

    void add(const Step& step);
    void add_primitives(const Level& level, const Step& step);
    void enter(const Step& step);
    void end_ray(const HitRecord& hit);
    /// Hands all rows on. Between rays.
    void hand_on();
    [[nodiscard]] Rows& rows(BlameTable table) { return rows_[static_cast<std::size_t>(table)]; }
    [[nodiscard]] std::uint32_t touch_mesh(std::uint32_t object) {
        return rows(BlameTable::meshes).touch({{}, 0, object});
    }

    Blame& blame_;
    const SceneView& view_;
    Observer observer_;
    Descent<Level> descent_;
    bool in_ray_ = false;
    bool failed_ = false;
    Rows rows_[blame_tables];
    BlamedWork total_;
};

}  // namespace raynest

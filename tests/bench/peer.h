// Another ray tracer in the same process, for ratios: the interface between raynest-bench and a
// peer's module.
//
// A peer is a module per CPU target, compiled with the flags of our kernel packs, so that what it
// inlines around its library (ray fills, filter callbacks) is as fast as ours. Both sides read the
// same array of rays and write the same 32-byte records.
#pragma once

#include "engine/bvh/build.h"
#include "engine/geometry/hit.h"
#include "engine/geometry/ray.h"
#include "engine/geometry/views.h"
#include "engine/packs/abi.h"
#include "engine/result.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::bench {

struct PeerCall {
    const Ray* rays;
    std::uint32_t ray_count;
    std::uint32_t hits_max;
    HitRecord* hits;            ///< ray_count * hits_max, in the peer's own ids; any: only `hit`
    std::uint32_t* hit_counts;  ///< multi only
};

/// One way in which a peer answers one query, on a scene of its own. Thread-safe.
class Peer {
public:
    virtual ~Peer() = default;
    virtual void trace(const PeerCall& call) const = 0;
    /// Rewrites the ids of a trace as path, object and triangle of the view; not timed.
    virtual void translate(std::span<HitRecord> hits) const = 0;
};

/// A row of a peer: its name and the queries that it answers.
struct PeerForm {
    std::string name;
    bool masks;           ///< tests alpha as our alpha_mask does
    std::uint32_t width;  ///< rays of a call: 1, or those of a packet
    std::vector<Query> queries;
};

/// One build of the library's tree, its vertices already in place.
struct PeerBuild {
    double wall_seconds;
    double cpu_seconds;  ///< the whole process's
};

/// Memory of a scene besides its vertices and indices: growth of the resident set, because the
/// library's own monitor misses most of an instance.
struct PeerMemory {
    std::uint64_t tree_bytes;      ///< at the root's commit
    std::int64_t reported_bytes;   ///< the same, by the monitor
    std::uint64_t instance_bytes;  ///< the scene with its instances less the scene without
};

class PeerLibrary {
public:
    virtual ~PeerLibrary() = default;
    /// As in the names of its forms: "embree".
    [[nodiscard]] virtual std::string name() const = 0;
    /// Version, instruction set, kind of tree, whether its asserts are live.
    [[nodiscard]] virtual std::string about() const = 0;
    /// How much faster the library is known to be with its asserts off: 1 when they are.
    [[nodiscard]] virtual double assert_factor(Query query, bool packets) const = 0;
    [[nodiscard]] virtual std::span<const PeerForm> forms() const = 0;
    /// The peer's own tree over the view's triangles and instances; `view` must outlive the peer.
    virtual Result<std::unique_ptr<Peer>> open(const PeerForm& form, Query query,
                                               const SceneView& view) = 0;
    virtual Result<PeerBuild> build(const SceneView& view, BuildQuality quality,
                                    unsigned threads) = 0;
    virtual Result<PeerMemory> weigh(const SceneView& view) = 0;
};

inline constexpr const char* peer_symbol = "raynest_bench_peer";
using PeerEntry = PeerLibrary* (*)();

/// Where the build puts what only raynest-bench loads.
std::filesystem::path module_dir();

/// Loads each peer's module of the best target up to `target_max` (v2, v3, v4) that this CPU runs;
/// variant_unknown when none was built.
Result<std::vector<std::unique_ptr<PeerLibrary>>> load_peers(std::string_view target_max);

}  // namespace raynest::bench

// tinybvh as a peer: single rays through its tree for AVX2, built by its usual builder and by the
// one with spatial splits. Of flat scenes: one tree over the root's own triangles.
#include "tests/bench/clock.h"
#include "tests/bench/peer.h"

#define TINYBVH_IMPLEMENTATION
#include <tiny_bvh.h>

#include <algorithm>
#include <array>
#include <string>
#include <utility>

namespace raynest::bench {
namespace {

class TinyTree {
public:
    explicit TinyTree(const SceneView& view) : root_(view.root) {
        const ObjectRecord& object = view.objects[view.root];
        corners_.reserve(3 * std::size_t{object.triangle_count});
        for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
            const GeometryRecord& geometry = view.geometries[object.first_geometry + i];
            const auto* const positions = view.attribute<float>(geometry.positions);
            const auto* const indices = view.attribute<std::uint32_t>(geometry.indices);
            for (std::size_t k = 0; k < 3 * std::size_t{geometry.triangle_count}; ++k) {
                const float* const at = positions + 3 * std::size_t{indices[k]};
                corners_.emplace_back(at[0], at[1], at[2], 0.0F);
            }
        }
    }

    void build(bool splits) {
        const auto count = static_cast<std::uint32_t>(corners_.size() / 3);
        if (splits)
            tree_.BuildHQ(corners_.data(), count);
        else
            tree_.Build(corners_.data(), count);
    }

    void closest(const PeerCall& call) const {
        for (std::uint32_t i = 0; i < call.ray_count; ++i) {
            tinybvh::Ray ray;
            const float begin = fill(ray, call.rays[i]);
            const float end = ray.hit.t;
            tree_.Intersect(ray);
            HitRecord& hit = call.hits[i] = HitRecord{};
            if (!(ray.hit.t < end)) continue;
            hit.t = ray.hit.t + begin;
            hit.u = ray.hit.u;
            hit.v = ray.hit.v;
            hit.triangle = ray.hit.prim;
            hit.hit = 1;
        }
    }
    void any(const PeerCall& call) const {
        for (std::uint32_t i = 0; i < call.ray_count; ++i) {
            tinybvh::Ray ray;
            fill(ray, call.rays[i]);
            HitRecord& hit = call.hits[i] = HitRecord{};
            hit.hit = tree_.IsOccluded(ray) ? 1 : 0;
        }
    }
    void translate(std::span<HitRecord> hits) const {
        for (HitRecord& hit : hits)
            if (hit.hit != 0) hit.path = 0, hit.object = root_;
    }

private:
    /// Fills what traversal reads. Its rays begin at 0, so one that begins later is moved; returns
    /// by how much.
    static float fill(tinybvh::Ray& to, const Ray& ray) {
        const Vec3 origin = ray.origin + ray.tmin * ray.direction;
        to.O = {origin.x, origin.y, origin.z};
        to.D = {ray.direction.x, ray.direction.y, ray.direction.z};
        to.rD = tinybvh::tinybvh_rcp(to.D);
        to.hit.t = std::min(ray.tmax - ray.tmin, BVH_FAR);
        return ray.tmin;
    }

    const std::uint32_t root_;
    std::vector<tinybvh::bvhvec4> corners_;
    tinybvh::BVH8_CPU tree_;
};

class Asked final : public Peer {
public:
    Asked(std::shared_ptr<const TinyTree> tree, Query query)
        : tree_(std::move(tree)),
          query_(query) {}
    void trace(const PeerCall& call) const override {
        query_ == query_any ? tree_->any(call) : tree_->closest(call);
    }
    void translate(std::span<HitRecord> hits) const override { tree_->translate(hits); }

private:
    const std::shared_ptr<const TinyTree> tree_;
    const Query query_;
};

class TinyLibrary final : public PeerLibrary {
public:
    [[nodiscard]] std::string name() const override { return "tinybvh"; }
    [[nodiscard]] std::string about() const override {
        return "tinybvh " + std::to_string(TINY_BVH_VERSION_MAJOR) + "." +
               std::to_string(TINY_BVH_VERSION_MINOR) + "." + std::to_string(TINY_BVH_VERSION_SUB) +
               ", BVH8_CPU with quads";
    }
    [[nodiscard]] double assert_factor(Query, bool) const override { return 1; }
    [[nodiscard]] std::span<const PeerForm> forms() const override {
        static const std::vector<PeerForm> forms{
            {"tinybvh", false, 1, {query_closest, query_any}},
            {"tinybvh-hq", false, 1, {query_closest, query_any}}};
        return forms;
    }
    Result<std::unique_ptr<Peer>> open(const PeerForm& form, Query query,
                                       const SceneView& view) override {
        auto& tree = trees_[form.name == "tinybvh-hq" ? 1 : 0];
        if (tree.first != &view) {
            auto made = make(view);
            if (!made) return tl::unexpected(made.error());
            (*made)->build(form.name == "tinybvh-hq");
            tree = {&view, std::move(*made)};
        }
        return std::make_unique<Asked>(tree.second, query);
    }
    Result<PeerBuild> build(const SceneView& view, BuildQuality quality,
                            unsigned threads) override {
        if (quality == BuildQuality::fast)
            return fail(ErrorCode::variant_unknown, "tinybvh is asked for medium and high builds");
        static_cast<void>(threads);  // its builders for AVX2 use one
        auto tree = make(view);
        if (!tree) return tl::unexpected(tree.error());
        const double wall = seconds_of(CLOCK_MONOTONIC);
        const double cpu = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
        (*tree)->build(quality == BuildQuality::high);
        return PeerBuild{seconds_of(CLOCK_MONOTONIC) - wall,
                         seconds_of(CLOCK_PROCESS_CPUTIME_ID) - cpu};
    }
    Result<PeerMemory> weigh(const SceneView&) override {
        return fail(ErrorCode::variant_unknown, "tinybvh's memory is not measured");
    }

private:
    static Result<std::shared_ptr<TinyTree>> make(const SceneView& view) {
        if (view.objects[view.root].instance_count != 0 ||
            view.objects[view.root].triangle_count == 0)
            return fail(ErrorCode::scene_unsupported,
                        "tinybvh is given scenes of triangles alone, without instances");
        return std::make_shared<TinyTree>(view);
    }

    std::array<std::pair<const SceneView*, std::shared_ptr<const TinyTree>>, 2> trees_{};
};

}  // namespace
}  // namespace raynest::bench

extern "C" [[gnu::visibility("default")]] raynest::bench::PeerLibrary* raynest_bench_peer() {
    return new raynest::bench::TinyLibrary;
}

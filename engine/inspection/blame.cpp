#include "engine/inspection/blame.h"

#include "engine/bvh/node.h"
#include "engine/geometry/path.h"
#include "engine/geometry/triangle.h"

#include <bit>
#include <new>
#include <span>

namespace raynest {
namespace {

/// Rows that a collector keeps before it hands them on: bounds its memory.
constexpr std::size_t collected_rows_max = 1 << 15;

std::uint32_t count_of(std::uint32_t lanes) {
    return static_cast<std::uint32_t>(std::popcount(lanes));
}

}  // namespace

std::size_t BlameKeyHash::operator()(const BlameKey& key) const noexcept {
    std::uint64_t hash = key.placements.first * 0x9E3779B97F4A7C15ULL;
    hash ^= (std::uint64_t{key.depth} << 32 | key.index) + (hash >> 29);
    return static_cast<std::size_t>(hash * 0xBF58476D1CE4E5B9ULL >> 7);
}

void BlamedWork::add(const BlamedWork& other) {
    boxes += other.boxes;
    prims += other.prims;
    wasted += other.wasted;
    rays += other.rays;
    hit_rays += other.hit_rays;
    candidates += other.candidates;
    refused += other.refused;
    entered += other.entered;
    needed += other.needed;
}

void Blame::add(BlameTable table, const BlameKey& key, const BlamedWork& work) {
    BlameRows& rows = rows_[static_cast<std::size_t>(table)];
    const auto found = rows.find(key);
    if (found != rows.end()) {
        found->second.add(work);
    } else if (rows_[0].size() + rows_[1].size() + rows_[2].size() < rows_max_) {
        rows.emplace(key, work);
    } else {
        overflowed_ = true;
    }
}

std::optional<CameraHits> watch_rays(const PixelRange& pixels, RayCaster& caster,
                                     const PixelArrays& arrays, const Observer& observer) {
    const std::span<Ray> rays = arrays.rays.first(pixels.rays());
    const std::span<HitRecord> hits = arrays.hits.first(rays.size());
    generate_samples(pixels.camera, pixels.samples, pixels.first, rays);
    if (!caster.observed(rays, hits, observer)) return std::nullopt;
    return count_hits(hits);
}

// ---- One chunk ----------------------------------------------------------------------

std::uint32_t BlameCollector::Rows::touch(const BlameKey& key) {
    const auto [found, is_new] =
        numbers_.try_emplace(key, static_cast<std::uint32_t>(rows_.size()));
    if (is_new) rows_.push_back({key, {}, {}, false});
    Row& row = rows_[found->second];
    if (!row.touched) {
        touched_.push_back(found->second);
        row.touched = true;
    }
    return found->second;
}

template <class Contains>
void BlameCollector::Rows::end_ray(Contains&& contains) {
    for (const std::uint32_t number : touched_) {
        Row& row = rows_[number];
        row.ray.rays = 1;
        if (row.ray.needed == 0) row.ray.entered = 0;
        if (contains(row.key)) {
            row.ray.hit_rays = 1;
        } else {
            row.ray.wasted = row.ray.work();
        }
        row.sum.add(row.ray);
        row.ray = {};
        row.touched = false;
    }
    touched_.clear();
}

void BlameCollector::Rows::clear() {
    numbers_.clear();
    rows_.clear();
    touched_.clear();
}

BlameCollector::BlameCollector(Blame& blame) : blame_(blame), view_(blame.scene().view()) {
    observer_.context = this;
    // Kernels take no exceptions.
    observer_.step = [](void* context, const Step* step) noexcept {
        auto& self = *static_cast<BlameCollector*>(context);
        try {
            if (!self.failed_) self.add(*step);
        } catch (const std::bad_alloc&) {
            self.failed_ = true;
        }
    };
    observer_.end = [](void* context, std::uint32_t /*ray*/, const HitRecord* hit) noexcept {
        auto& self = *static_cast<BlameCollector*>(context);
        try {
            if (!self.failed_) self.end_ray(*hit);
        } catch (const std::bad_alloc&) {
            self.failed_ = true;
        }
    };
}

void BlameCollector::finish() {
    if (failed_) throw std::bad_alloc();
    hand_on();
}

void BlameCollector::hand_on() {
    blame_.with_lock([&] {
        for (std::size_t table = 0; table < blame_tables; ++table) {
            for (const Row& row : rows_[table].all())
                blame_.add(static_cast<BlameTable>(table), row.key, row.sum);
        }
        blame_.add_total(total_);
    });
    for (Rows& rows : rows_) rows.clear();
    total_ = {};
}

void BlameCollector::add(const Step& step) {
    if (!in_ray_) {
        in_ray_ = true;
        Level root;
        root.object = view_.root;
        root.mesh = touch_mesh(view_.root);
        descent_.begin(root);
    }
    const Level& level = descent_.at(step);
    switch (step.kind) {
        case step_node: {
            const std::uint32_t boxes = count_of(step.tested);
            total_.boxes += boxes;
            rows(BlameTable::meshes).ray_in(level.mesh).boxes += boxes;
            if (level.group != no_id)
                rows(BlameTable::instances).ray_in(level.group).boxes += boxes;
            return;
        }
        case step_primitives:
            return add_primitives(level, step);
        case step_instance:
            if (step.outcome == outcome_accepted) enter(step);
            return;
        case step_candidate:
            return;
    }
}

void BlameCollector::add_primitives(const Level& level, const Step& step) {
    BlamedWork work;
    work.prims = count_of(step.tested);
    work.candidates = count_of(step.passed | step.rejected);
    work.refused = count_of(step.rejected);
    total_.add(work);
    rows(BlameTable::meshes).ray_in(level.mesh).add(work);
    if (level.group != no_id) rows(BlameTable::instances).ray_in(level.group).add(work);

    Rows& materials = rows(BlameTable::materials);
    const ObjectRecord& object = view_.objects[step.object];
    if (object.triangle_count == 0 || object.geometry_count == 1) {
        const std::uint32_t material =
            object.triangle_count == 0 ? no_id : view_.geometries[object.first_geometry].material;
        materials.ray_in(materials.touch({{}, 0, material})).add(work);
        return;
    }
    const TriangleBlock& block = view_.blocks[object.first_block + step.place];
    for (std::uint32_t lanes = step.tested; lanes != 0; lanes &= lanes - 1) {
        const int lane = std::countr_zero(lanes);
        const std::uint32_t material = view_.geometry_of(object, block.triangle[lane]).material;
        BlamedWork& ray = materials.ray_in(materials.touch({{}, 0, material}));
        ++ray.prims;
        ray.candidates += (step.passed | step.rejected) >> lane & 1U;
        ray.refused += step.rejected >> lane & 1U;
    }
}

void BlameCollector::enter(const Step& step) {
    const InstanceRecord& instance = view_.instances[step.place];
    const Level& parent = descent_.levels().back();
    rows(BlameTable::meshes).ray_in(parent.mesh).entered += 1;
    Level level;
    level.object = instance.object;
    level.instance = step.place;
    level.mesh = touch_mesh(instance.object);
    level.group = parent.group;
    const auto depth = static_cast<std::uint32_t>(descent_.levels().size());
    if (blame_.level() == innermost_level || blame_.level() == depth) {
        const PlacementRange placements{step.path + instance.path_base,
                                        view_.objects[instance.object].placement_count};
        level.group = rows(BlameTable::instances).touch({placements, depth, instance.object});
    }
    descent_.enter(level);
}

void BlameCollector::end_ray(const HitRecord& hit) {
    in_ray_ = false;
    ++total_.rays;
    std::uint32_t material = no_id;
    if (hit.hit != 0) {
        material = name_primitive(view_, view_.objects[hit.object], hit.triangle).material;
        std::uint32_t parent = view_.root;
        walk_path(view_, hit.path, [&](std::uint32_t instance) {
            rows(BlameTable::meshes).ray_in(touch_mesh(parent)).needed += 1;
            parent = view_.instances[instance].object;
        });
    }
    rows(BlameTable::instances).end_ray([&](const BlameKey& key) {
        return hit.hit != 0 && key.placements.contains(hit.path);
    });
    rows(BlameTable::meshes).end_ray([&](const BlameKey& key) {
        return hit.hit != 0 && key.index == hit.object;
    });
    rows(BlameTable::materials).end_ray([&](const BlameKey& key) {
        return hit.hit != 0 && key.index == material;
    });
    for (const Rows& table : rows_) {
        if (table.all().size() > collected_rows_max) return hand_on();
    }
}

}  // namespace raynest

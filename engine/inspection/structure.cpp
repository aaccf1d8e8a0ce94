#include "engine/inspection/structure.h"

#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"
#include "engine/queries/triangle_place.h"
#include "engine/scene/tree_overlap.h"
#include "engine/scene/tree_statistics.h"

#include <algorithm>
#include <limits>

namespace raynest {
namespace {

/// Trees and instances that a collection of boxes looks at, at most.
constexpr std::size_t visited_max = 1 << 18;

/// Counts the ways from the root to each object.
std::vector<std::uint64_t> count_ways(const SceneView& scene) {
    std::vector<std::uint64_t> ways(scene.object_count);
    ways[scene.root] = 1;
    for (std::uint32_t i = scene.object_count; i-- > 0;) {  // children come first
        const ObjectRecord& object = scene.objects[i];
        for (std::uint32_t k = 0; k < object.instance_count; ++k) {
            std::uint64_t& child = ways[scene.instances[object.first_instance + k].object];
            if (__builtin_add_overflow(child, ways[i], &child))
                child = std::numeric_limits<std::uint64_t>::max();
        }
    }
    return ways;
}

std::uint64_t bytes_of(const SceneView& scene, const ObjectRecord& object) {
    std::uint64_t bytes = sizeof(ObjectRecord);
    bytes += std::uint64_t{object.node_count} * sizeof(Node);
    bytes += std::uint64_t{object.block_count} * sizeof(TriangleBlock);
    if (object.texcoord_blocks != no_offset)
        bytes += std::uint64_t{object.block_count} * sizeof(TexcoordBlock);
    bytes += records_bytes(object);
    bytes += std::uint64_t{object.instance_count} * (sizeof(InstanceRecord) + sizeof(InstanceInfo));
    for (std::uint32_t g = 0; g < object.geometry_count; ++g) {
        const GeometryRecord& geometry = scene.geometries[object.first_geometry + g];
        bytes += sizeof(GeometryRecord) + std::uint64_t{geometry.vertex_count} * sizeof(Vec3) +
                 std::uint64_t{geometry.triangle_count} * 3 * sizeof(std::uint32_t);
        for (const std::uint64_t texcoords : geometry.texcoords)
            if (texcoords != no_offset)
                bytes += std::uint64_t{geometry.vertex_count} * sizeof(Vec2);
        if (geometry.colours != no_offset) bytes += std::uint64_t{geometry.vertex_count} * 4;
        if (geometry.opacity != no_offset)
            bytes += std::uint64_t{geometry.triangle_count} * sizeof(Opacity);
    }
    return bytes;
}

/// Collects the boxes of trees; see tree_boxes().
class BoxCollector {
public:
    BoxCollector(const SceneView& scene, const BoxRequest& request,
                 const std::function<bool()>& stop)
        : scene_(scene),
          request_(request),
          stop_(stop) {}

    TreeBoxes collect() {
        enter({scene_.root, 0, 0, {}});
        return std::move(found_);
    }

private:
    struct Place {
        std::uint32_t object;
        std::uint32_t level;
        std::uint64_t path;
        Transform to_scene;
    };

    void enter(const Place& place) {
        const ObjectRecord& object = scene_.objects[place.object];
        if (++visited_ > visited_max || (visited_ % 256 == 0 && stop_())) found_.complete = false;
        if (!found_.complete) return;
        if (place.level == request_.level) return add_tree(place, object);
        if (object.levels <= request_.level - place.level) return;  // no tree lies so deep
        for (std::uint32_t k = 0; k < object.instance_count && found_.complete; ++k) {
            const std::uint32_t index = object.first_instance + k;
            const InstanceRecord& instance = scene_.instances[index];
            const std::uint64_t first = place.path + instance.path_base;
            const std::uint64_t placements = scene_.objects[instance.object].placement_count;
            const bool is_on_way = request_.path == no_path || request_.path - first < placements;
            if (!is_on_way) continue;
            enter({instance.object, place.level + 1, first,
                   compose(place.to_scene, scene_.instance_infos[index].to_parent)});
        }
    }

    void add_tree(const Place& place, const ObjectRecord& object) {
        PlacedTree tree{place.path, place.object, place.to_scene, {}};
        if (object.root == child_empty) return;
        struct Entry {
            std::uint32_t child;
            TreeBox box;
        };
        std::vector<Entry> layer{{object.root, {0, is_leaf(object.root), object.bounds}}};
        for (std::uint32_t depth = 0; !layer.empty() && depth <= request_.depth_max; ++depth) {
            std::vector<Entry> next;
            for (const auto& [child, box] : layer) {
                if (depth >= request_.depth_min) {
                    if (count_ == request_.count) {
                        found_.complete = false;
                        break;
                    }
                    ++count_;
                    tree.boxes.push_back(box);
                }
                if (is_leaf(child) || depth == request_.depth_max) continue;
                const Node& node = scene_.nodes[object.first_node + child];
                for (std::uint32_t slot = 0; slot < 8; ++slot) {
                    if ((node.valid() >> slot & 1U) == 0) continue;
                    const Box inner{
                        {node.lower[0][slot], node.lower[1][slot], node.lower[2][slot]},
                        {node.upper[0][slot], node.upper[1][slot], node.upper[2][slot]}};
                    next.push_back(
                        {node.child[slot], {depth + 1, is_leaf(node.child[slot]), inner}});
                }
            }
            visited_ += next.size();
            if (visited_ > visited_max || stop_()) found_.complete = false;
            if (!found_.complete) break;
            layer = std::move(next);
        }
        if (!tree.boxes.empty()) found_.trees.push_back(std::move(tree));
    }

    const SceneView& scene_;
    const BoxRequest& request_;
    const std::function<bool()>& stop_;
    TreeBoxes found_;
    std::size_t visited_ = 0;
    std::size_t count_ = 0;
};

}  // namespace

std::vector<ObjectFacts> object_facts(const Snapshot& scene, std::uint64_t first,
                                      std::size_t count) {
    const SceneView& view = scene.view();
    if (first >= view.object_count) return {};
    const std::vector<std::uint64_t> ways = count_ways(view);
    const std::vector<TreeStatistics> trees = measure_each_tree(view);
    const std::vector<double> overlaps = measure_overlaps(view);
    const std::uint64_t last = std::min<std::uint64_t>(view.object_count, first + count);
    std::vector<ObjectFacts> all;
    for (std::uint64_t i = first; i < last; ++i) {
        const ObjectRecord& object = view.objects[i];
        all.push_back({ways[i], bytes_of(view, object), trees[i].height, trees[i].sah_cost,
                       overlaps[i], area_sums(view, object).share()});
    }
    return all;
}

std::vector<PlacementFacts> placement_facts(const SceneView& scene, std::uint64_t first,
                                            std::size_t count) {
    std::vector<PlacementFacts> all;
    const ObjectRecord& root = scene.objects[scene.root];
    for (std::uint64_t path = first; path < root.placement_count && all.size() < count; ++path) {
        PlacementFacts facts;
        facts.path = path;
        const ObjectRecord* object = walk_path(scene, path, [&](std::uint32_t index) {
            if (facts.outermost == no_id) facts.outermost = index - root.first_instance;
            facts.mask = scene.instance_infos[index].mask;
            ++facts.depth;
            facts.to_scene = compose(facts.to_scene, scene.instance_infos[index].to_parent);
        });
        facts.object = static_cast<std::uint32_t>(object - scene.objects);
        all.push_back(facts);
    }
    return all;
}

TreeBoxes tree_boxes(const SceneView& scene, const BoxRequest& request,
                     const std::function<bool()>& stop) {
    return BoxCollector(scene, request, stop).collect();
}

}  // namespace raynest

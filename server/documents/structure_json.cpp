#include "server/documents/structure_json.h"

#include "engine/geometry/moved_box.h"
#include "engine/inspection/names.h"
#include "engine/inspection/structure.h"
#include "engine/scene/tree_overlap.h"
#include "protocol/text.h"
#include "server/documents/json.h"
#include "server/documents/scene_info.h"

namespace raynest::server {
namespace {

class StructureWriter {
public:
    StructureWriter(const NamedScene& scene, const StructureRequest& request,
                    const protocol::Limits& limits)
        : named_(scene),
          scene_(scene.snapshot()),
          view_(scene_.view()),
          request_(request),
          limits_(limits) {}

    [[nodiscard]] Reply<Json> document(const Stop& stop) const {
        Json json{{"scene", named_.name}, {"hash", scene_.digest()}, {"epoch", named_.epoch}};
        switch (request_.kind) {
            case StructureRequest::Kind::objects:
                add_objects(json);
                break;
            case StructureRequest::Kind::placements:
                add_placements(json);
                break;
            case StructureRequest::Kind::boxes:
                add_boxes(json, stop);
                break;
            case StructureRequest::Kind::paths:
                if (auto added = add_paths(json, stop); !added)
                    return tl::unexpected(added.error());
                break;
            case StructureRequest::Kind::tree:
                add_tree(json);
                break;
        }
        return json;
    }

private:
    void add_objects(Json& json) const {
        json["total"] = view_.object_count;
        json["first"] = request_.first;
        Json& rows = json["rows"] = Json::array();
        std::uint64_t index = request_.first;
        for (const ObjectFacts& facts : object_facts(scene_, request_.first, request_.count)) {
            const ObjectRecord& object = view_.objects[index];
            rows.push_back({{"object", index},
                            {"name", name_of(static_cast<std::uint32_t>(index))},
                            {"triangles", object.triangle_count},
                            {"records", object.record_count},
                            {"instances", object.instance_count},
                            {"placements", facts.placements},
                            {"levels", object.levels},
                            {"nodes", object.node_count},
                            {"bytes", facts.bytes},
                            {"height", facts.height},
                            {"sah_cost", number(static_cast<float>(facts.sah_cost))},
                            {"epo", number(static_cast<float>(facts.overlap))},
                            {"box_share", number(static_cast<float>(facts.box_share))}});
            ++index;
        }
    }

    void add_placements(Json& json) const {
        json["total"] = view_.objects[view_.root].placement_count;
        json["first"] = request_.first;
        Json& rows = json["rows"] = Json::array();
        for (const PlacementFacts& facts : placement_facts(view_, request_.first, request_.count)) {
            const ObjectRecord& object = view_.objects[facts.object];
            rows.push_back(
                {{"path", facts.path},
                 {"name", clean(instance_path(scene_, {facts.path, 1}, path_steps_max))},
                 {"object", facts.object},
                 {"mesh", name_of(facts.object)},
                 {"instance", facts.outermost == no_id ? Json(nullptr) : Json(facts.outermost)},
                 {"mask", facts.mask},
                 {"depth", facts.depth},
                 {"triangles", object.triangle_count},
                 {"box", world_box(moved_box(object.bounds, facts.to_scene), scene_.origin())}});
        }
    }

    Reply<void> add_paths(Json& json, const Stop& stop) const {
        Json& rows = json["rows"] = Json::array();
        for (const std::uint64_t path : request_.paths) {
            if (stop.requested()) break;
            if (path == no_path) {
                rows.push_back("");
                continue;
            }
            const auto steps = expand_path(scene_, path);
            if (!steps) return refuse(Code::invalid_field, steps.error().message);
            rows.push_back(protocol::clean_text(path_name(*steps), limits_.text_bytes_max));
        }
        return {};
    }

    void add_boxes(Json& json, const Stop& stop) const {
        BoxRequest boxes{request_.level, request_.depth_min, request_.depth_max, request_.count};
        if (request_.one) boxes.path = request_.first;
        const TreeBoxes found = tree_boxes(view_, boxes, [&] { return stop.requested(); });
        json["level"] = request_.level;
        json["complete"] = found.complete;
        Json& trees = json["trees"] = Json::array();
        for (const PlacedTree& tree : found.trees) {
            Json list = Json::array();
            for (const TreeBox& each : tree.boxes)
                list.push_back({each.depth, each.is_leaf ? 1 : 0, number(each.box.lower.x),
                                number(each.box.lower.y), number(each.box.lower.z),
                                number(each.box.upper.x), number(each.box.upper.y),
                                number(each.box.upper.z)});
            trees.push_back({{"path", tree.path},
                             {"object", tree.object},
                             {"mesh", name_of(tree.object)},
                             {"to_world", rows_of(tree.to_scene)},
                             {"boxes", std::move(list)}});
        }
    }

    void add_tree(Json& json) const {
        json["sah_cost"] = number(static_cast<float>(scene_.statistics().trees.sah_cost));
        json["epo"] = number(static_cast<float>(measure_overlap(view_)));
    }

    /// The transform to the world, row by row.
    [[nodiscard]] Json rows_of(const Transform& transform) const {
        Json rows = Json::array();
        for (std::size_t i = 0; i < transform.m.size(); ++i) {
            const double shift = i % 4 == 3 ? scene_.origin()[i / 4] : 0;
            if (shift == 0)
                rows.push_back(number(transform.m[i]));
            else
                rows.push_back(shift + static_cast<double>(transform.m[i]));
        }
        return rows;
    }
    [[nodiscard]] std::string name_of(std::uint32_t object) const {
        return clean(view_.names + view_.objects[object].name);
    }
    [[nodiscard]] std::string clean(const std::string& name) const {
        return protocol::clean_text(name, limits_.name_bytes_max);
    }

    const NamedScene& named_;
    const Snapshot& scene_;
    const SceneView& view_;
    const StructureRequest& request_;
    const protocol::Limits& limits_;
};

}  // namespace

Reply<std::string> structure_json(const NamedScene& scene, const StructureRequest& request,
                                  const protocol::Limits& limits, const Stop& stop) {
    const auto document = StructureWriter(scene, request, limits).document(stop);
    if (!document) return tl::unexpected(document.error());
    return text_of(*document);
}

}  // namespace raynest::server

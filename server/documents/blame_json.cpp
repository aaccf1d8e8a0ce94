#include "server/documents/blame_json.h"

#include "engine/inspection/diagnosis.h"
#include "engine/inspection/ranking.h"
#include "protocol/text.h"
#include "server/documents/json.h"
#include "server/documents/scene_info.h"

#include <algorithm>
#include <cstddef>

namespace raynest::server {
namespace {

double share(std::uint64_t part, std::uint64_t whole) {
    return whole == 0 ? 0 : static_cast<double>(part) / static_cast<double>(whole);
}

class BlameWriter {
public:
    BlameWriter(const Plan& plan, const Blame& blame, const BlameContext& context)
        : plan_(plan),
          blame_(blame),
          context_(context),
          scene_(plan.scene.snapshot()),
          view_(scene_.view()) {}

    Json document() const {
        Json json{
            {"scene", plan_.scene.name},
            {"hash", scene_.digest()},
            {"epoch", plan_.scene.epoch},
            {"intersector", plan_.variant->name},
            {"target", plan_.variant->target},
            {"camera", clean(context_.camera)},
            {"size", {context_.width, context_.height}},
            {"rays", std::uint64_t{context_.width} * context_.height},
            {"levels", view_.objects[view_.root].levels},
            {"level", blame_.level() == innermost_level ? Json(nullptr) : Json(blame_.level())}};
        const BlamedWork& total = blame_.total();
        json["total"] = {{"work", total.work()}, {"boxes", total.boxes}, {"prims", total.prims}};
        json["instances"] = table(BlameTable::instances);
        json["meshes"] = table(BlameTable::meshes);
        json["materials"] = table(BlameTable::materials);
        json["findings"] = Json::array();
        for (const Finding& finding : diagnose(blame_)) {
            json["findings"].push_back(
                {{"finding", finding.name},
                 {"subject", clean(finding.subject)},
                 {finding.is_material ? "material" : "object", index_json(finding.index)},
                 {"figure", finding.figure},
                 {"threshold", finding.threshold},
                 {"side", finding.below ? "below" : "above"},
                 {"unit", finding.unit},
                 {"share", finding.share},
                 {"remedy", finding.remedy}});
        }
        return json;
    }

private:
    Json table(BlameTable which) const {
        const Ranking ranking = rank(blame_, which);
        const std::size_t listed = std::min<std::size_t>(context_.top, ranking.rows.size());
        Json rows = Json::array();
        std::uint64_t others = ranking.total - ranking.remainder;
        for (std::size_t i = 0; i < listed; ++i) {
            rows.push_back(row_json(which, ranking.rows[i], ranking.total));
            others -= ranking.rows[i].ranked;
        }
        return {
            {"rows", rows},
            {"others",
             {{"rows", ranking.rows.size() - listed},
              {"work", others},
              {"share", share(others, ranking.total)}}},
            {"remainder",
             {{"work", ranking.remainder}, {"share", share(ranking.remainder, ranking.total)}}}};
    }

    Json row_json(BlameTable which, const RankedRow& row, std::uint64_t total) const {
        const BlamedWork& work = row.work;
        Json json = key_json(which, row.key);
        json["share"] = share(row.ranked, total);
        json["wasted"] = share(work.wasted, work.work());
        json["work_per_ray"] = share(row.ranked, work.rays);
        json["work"] = row.ranked;
        if (which != BlameTable::materials) json["boxes"] = work.boxes;
        json["prims"] = work.prims;
        json["rays"] = work.rays;
        json["hit_rays"] = work.hit_rays;
        json["candidates"] = work.candidates;
        json["refused"] = work.refused;
        return json;
    }

    Json key_json(BlameTable which, const BlameKey& key) const {
        switch (which) {
            case BlameTable::instances:
                return {{"name", clean(instance_path(scene_, key.placements, key.depth))},
                        {"mesh", mesh_name(key.index)},
                        {"object", key.index},
                        {"level", key.depth},
                        {"path", key.placements.first},
                        {"placements", key.placements.count}};
            case BlameTable::meshes:
                return {{"name", mesh_name(key.index)}, {"index", key.index}};
            case BlameTable::materials:
                break;
        }
        if (key.index == no_id) return {{"name", nullptr}, {"index", nullptr}};
        return {{"name", clean(view_.names + view_.materials[key.index].name)},
                {"index", key.index}};
    }

    static Json index_json(std::uint32_t index) {
        return index == no_id ? Json(nullptr) : Json(index);
    }
    std::string mesh_name(std::uint32_t object) const {
        return clean(view_.names + view_.objects[object].name);
    }
    std::string clean(const std::string& name) const {
        return protocol::clean_text(name, context_.limits.name_bytes_max);
    }

    const Plan& plan_;
    const Blame& blame_;
    const BlameContext& context_;
    const Snapshot& scene_;
    const SceneView& view_;
};

}  // namespace

std::string blame_json(const Plan& plan, const Blame& blame, const BlameContext& context) {
    return text_of(BlameWriter(plan, blame, context).document());
}

}  // namespace raynest::server

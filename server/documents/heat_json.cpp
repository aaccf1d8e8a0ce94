#include "server/documents/heat_json.h"

#include "engine/scene/edits/pose.h"
#include "protocol/base64.h"
#include "protocol/text.h"
#include "server/documents/json.h"
#include "server/documents/plan_text.h"
#include "server/documents/scene_info.h"

namespace raynest::server {
namespace {

/// Bytes of the document around its rows and its file, and of a row, at most.
constexpr std::uint64_t head_bytes = 128 * 1024;
constexpr std::uint64_t row_bytes = 256;

/// Returns "2.5 s of run", for people; null where the scene is as it was loaded.
Json moment_json(const Plan& plan, const protocol::Limits& limits) {
    if (!plan.time) return nullptr;
    const Snapshot& scene = plan.scene.snapshot();
    const auto moment = find_moment(scene, plan.animation, *plan.time);
    const std::size_t index = moment ? moment->animation : 0;
    const auto animations = animations_of(scene, index + 1);
    const std::string name = index < animations.size() ? animations[index].name : "";
    return number_text(*plan.time) + " s of " +
           (name.empty() ? "animation " + std::to_string(index)
                         : protocol::clean_text(name, limits.name_bytes_max));
}

Json job_json(const Plan& plan, const protocol::Limits& limits) {
    return {{"scene", plan.scene.name},
            {"hash", plan.scene.snapshot().digest()},
            {"epoch", plan.scene.epoch},
            {"moment", moment_json(plan, limits)},
            {"intersector", protocol::clean_text(plan.variant->name, limits.name_bytes_max)},
            {"settings", protocol::clean_text(settings_text(plan), limits.text_bytes_max)},
            {"mask", plan.mask}};
}

Json statistics_json(const HeatStatistics& statistics) {
    return {{"min", statistics.min}, {"mean", statistics.mean}, {"p50", statistics.p50},
            {"p90", statistics.p90}, {"p99", statistics.p99},   {"max", statistics.max}};
}

}  // namespace

std::string heat_json(const HeatDocument& document) {
    const SceneStatistics& scene = document.plan.scene.snapshot().statistics();
    Json json = job_json(document.plan, document.limits);
    if (!document.selected.hide.empty()) json["hide"] = document.selected.hide;
    if (!document.selected.only.empty()) json["only"] = document.selected.only;
    if (document.plan.selected != nullptr)
        json["hidden_boxes"] = document.plan.selected->skips_boxes() ? "left out" : "counted";
    json["target"] = document.plan.variant->target;
    json["other"] =
        document.other == nullptr ? Json(nullptr) : job_json(*document.other, document.limits);
    json["camera"] = protocol::clean_text(document.camera, document.limits.name_bytes_max);
    json["size"] = {document.width, document.height};
    json["rays"] = document.statistics.rays;
    json["levels"] = scene.levels;
    json["bytes"] = scene.bytes;
    json["triangles"] = scene.instanced_triangles;
    json["metric"] = document.options.metric;
    json["count"] = document.options.count;
    json["range"] = {document.statistics.range_low, document.statistics.range_high};
    json["clipped"] = document.statistics.clipped;
    json["below"] = document.statistics.below;
    json["histogram"] = {{"low", document.statistics.min},
                         {"high", document.statistics.max + 1},
                         {"bars", document.histogram}};
    Json rows = Json::object();
    for (const HeatDocument::Row& row : document.rows)
        rows[row.metric] = statistics_json(row.statistics);
    json["statistics"] = std::move(rows);
    if (const HeatDocument::File& file = document.file; !file.encode.empty())
        json["file"] = {{"encode", file.encode},
                        {"width", file.width},
                        {"height", file.height},
                        {"base64", protocol::to_base64(file.bytes)}};
    return text_of(json);
}

std::uint64_t heat_json_bytes_max(std::size_t metrics, std::uint64_t file_bytes) {
    return head_bytes + row_bytes * metrics + protocol::base64_length(file_bytes);
}

}  // namespace raynest::server

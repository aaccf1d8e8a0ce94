#include "client/scene_info.h"

#include <iostream>
#include <string>
#include <vector>

namespace raynest::client {
namespace {

/// {reason: n}; both lists are equally long, as validate() has checked.
Json skipped_json(const wire::SceneInfo& info) {
    Json skipped = Json::object();
    const std::vector<std::string> reasons = protocol::strings(info.skipped_reasons());
    for (std::size_t i = 0; i < reasons.size(); ++i)
        skipped[reasons[i]] = info.skipped_counts()->Get(static_cast<flatbuffers::uoffset_t>(i));
    return skipped;
}

std::string joined(const std::vector<std::string>& items) {
    std::string line;
    for (const std::string& item : items) line += (line.empty() ? "" : ", ") + item;
    return line.empty() ? "none" : line;
}

}  // namespace

Json scene_json(const wire::SceneInfo& info) {
    Json json;
    json["name"] = protocol::text(info.name());
    json["hash"] = protocol::text(info.hash());
    json["epoch"] = info.epoch();
    json["unique_triangles"] = info.unique_triangles();
    json["instanced_triangles"] = info.instanced_triangles();
    json["instances"] = info.instances();
    json["levels"] = info.levels();
    json["materials"] = info.materials();
    json["mask_materials"] = info.mask_materials();
    json["bytes"] = info.bytes();
    json["cameras"] = protocol::strings(info.cameras());
    json["skipped"] = skipped_json(info);
    json["warnings"] = protocol::strings(info.warnings());
    return json;
}

void print_scene(const wire::SceneInfo& info) {
    std::vector<std::vector<std::string>> rows = {
        {"scene", std::string(protocol::text(info.name())) + " (epoch " +
                      std::to_string(info.epoch()) + ", " +
                      std::string(protocol::text(info.hash())) + ")"},
        {"triangles", grouped(info.unique_triangles()) + " unique, " +
                          grouped(info.instanced_triangles()) + " instanced"},
        {"instances", grouped(info.instances()) + " on " + std::to_string(info.levels()) +
                          (info.levels() == 1 ? " level" : " levels")},
        {"materials", std::to_string(info.materials()) + ", " +
                          std::to_string(info.mask_materials()) + " with an alpha mask"},
        {"memory", bytes_text(info.bytes())},
        {"cameras", joined(protocol::strings(info.cameras()))},
    };
    const std::vector<std::string> types = protocol::strings(info.record_types());
    if (!types.empty()) rows.push_back({"primitives", joined(types)});
    const Json skipped = skipped_json(info);
    for (const auto& [reason, count] : skipped.items())
        rows.push_back({"skipped", grouped(count.get<std::uint64_t>()) + " " + reason});
    for (const std::string& warning : protocol::strings(info.warnings()))
        rows.push_back({"warning", warning});
    print_table(rows);
}

}  // namespace raynest::client

#include "client/output/scene_text.h"

#include "client/ground/text.h"
#include "client/ground/wording.h"
#include "client/output/output.h"
#include "client/requests/scene_origin.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iomanip>
#include <sstream>
#include <string>
#include <vector>

namespace raynest::client {
namespace {

/// Returns {name: n}; validate() has checked that both lists have the same length.
template <class Names, class Counts>
Json counts_json(const Names* names, const Counts* counts) {
    Json json = Json::object();
    flatbuffers::uoffset_t i = 0;
    for (const std::string& name : protocol::strings(names)) json[name] = counts->Get(i++);
    return json;
}

/// How long each animation is.
std::vector<double> seconds_of(const wire::SceneInfo& info) {
    const auto* const seconds = info.animation_seconds();
    return seconds == nullptr ? std::vector<double>()
                              : std::vector(seconds->begin(), seconds->end());
}

std::vector<std::string> warnings(const wire::SceneInfo& info) {
    std::vector<std::string> texts = protocol::strings(info.warnings());
    for (std::string& text : texts) text = localize_message(text);
    return texts;
}

std::string joined(const std::vector<std::string>& items) {
    std::string line;
    for (const std::string& item : items) line += (line.empty() ? "" : ", ") + item;
    return line.empty() ? "none" : line;
}

/// Returns "0 front", "1 side": the words that --camera takes.
std::vector<std::string> numbered(std::vector<std::string> names) {
    for (std::size_t i = 0; i < names.size(); ++i)
        names[i] = std::to_string(i) + (names[i].empty() ? " (no name)" : " " + names[i]);
    return names;
}

/// Returns "1 node" or "42,241 nodes".
std::string counted(std::uint64_t count, const std::string& what) {
    return grouped(count) + ' ' + what + (count == 1 ? "" : "s");
}

/// Returns "1 camera" or "7 cameras", for a reason that is a plural; some reasons have words of
/// their own.
std::string skipped_text(const std::string& reason, std::uint64_t count) {
    struct Words {
        const char *reason, *what, *more;
    };
    constexpr std::array<Words, 3> own = {{
        {"singular_instances", "placement", " scaled to 0"},
        {"singular_instance_triangles", "triangle", " of placements scaled to 0"},
        {"singular_unique_triangles", "triangle", " that only such placements show"},
    }};
    const auto found = std::ranges::find(own, reason, &Words::reason);
    if (found != own.end()) return counted(count, found->what) + found->more;
    std::string words = reason;
    std::ranges::replace(words, '_', ' ');
    if (count == 1 && words.ends_with('s')) words.pop_back();
    return grouped(count) + ' ' + words;
}

/// Bytes of nodes and leaf blocks per triangle; 0 for a scene without triangles.
double bytes_per_triangle(const wire::SceneInfo& info) {
    const auto triangles = static_cast<double>(info.unique_triangles());
    return triangles > 0 ? static_cast<double>(info.tree_bytes()) / triangles : 0;
}

/// ", 12 edits since, built again 3 times; the last edit moved car-3"; empty for a scene that was never edited.
std::string edits_text(const wire::SceneInfo& info) {
    std::string text;
    if (info.refits() != 0) text += ", " + counted(info.refits(), "edit") + " since";
    if (info.rebuilds() != 0) text += ", built again " + counted(info.rebuilds(), "time");
    if (const auto last = protocol::text(info.last_edit()); !last.empty())
        text += "; the last edit " + std::string(last);
    return text;
}

/// "medium in 0.412 s, SAH cost 17.8, EPO 3.1, height 11, 42,241 nodes, 278,468 leaf blocks,
/// 50 B/triangle".
std::string tree_text(const wire::SceneInfo& info, const Json& epo) {
    const auto rounded = [](double value, int digits) {
        std::ostringstream text;
        text << std::fixed << std::setprecision(digits) << value;
        return text.str();
    };
    std::string text(protocol::text(info.build()));
    if (info.build_seconds() > 0) text += " in " + seconds_text(info.build_seconds());
    text += ", SAH cost " + rounded(info.sah_cost(), 1);
    if (epo.is_number()) text += ", EPO " + rounded(epo.get<double>(), 1);
    return text + ", height " + std::to_string(info.tree_height()) + ", " +
           counted(info.nodes(), "node") + ", " + counted(info.leaf_blocks(), "leaf block") + ", " +
           rounded(bytes_per_triangle(info), 0) + " B/triangle" + edits_text(info);
}

/// False for a scene that has nothing to hit.
bool has_box(const wire::SceneInfo& info) {
    const auto *lower = info.box_min(), *upper = info.box_max();
    return lower != nullptr && upper != nullptr && lower->x() <= upper->x();
}

/// A corner of the scene's box in the world; null where there is none.
Json corner(const wire::SceneInfo& info, const wire::Vec3* relative) {
    if (!has_box(info)) return nullptr;
    const WorldPoint origin = origin_of(info);
    Json json = Json::array();
    for (const auto& [x, shift] : {std::pair{relative->x(), origin[0]},
                                   {relative->y(), origin[1]},
                                   {relative->z(), origin[2]}})
        json.push_back(std::stod(world_text(x, shift)));  // whole numbers, too, are floats
    return json;
}

std::string corner_text(const wire::SceneInfo& info, const wire::Vec3* relative) {
    std::string text;
    for (const Json& x : corner(info, relative)) {
        const std::string number = x.dump();
        const bool is_whole = number.ends_with(".0");
        text += (text.empty() ? "" : ", ") + number.substr(0, number.size() - (is_whole ? 2 : 0));
    }
    return "(" + text + ")";
}

std::string box_text(const wire::SceneInfo& info) {
    if (!has_box(info)) return "none: nothing can be hit";
    return corner_text(info, info.box_min()) + " to " + corner_text(info, info.box_max());
}

}  // namespace

Json scene_json(const wire::SceneInfo& info) {
    Json json;
    json["name"] = protocol::text(info.name());
    json["hash"] = protocol::text(info.hash());
    json["epoch"] = info.epoch();
    json["unique_triangles"] = info.unique_triangles();
    json["instanced_triangles"] = info.instanced_triangles();
    json["degenerate_triangles"] = info.degenerate_triangles();
    json["instances"] = info.instances();
    json["levels"] = info.levels();
    json["materials"] = info.materials();
    json["mask_materials"] = info.mask_materials();
    json["blend_materials"] = info.blend_materials();
    json["meshes"] = info.meshes();
    json["records"] = counts_json(info.record_types(), info.record_counts());
    json["intersector"] = protocol::text(info.intersector());
    json["bytes"] = info.bytes();
    json["build"] = protocol::text(info.build());
    json["build_seconds"] = info.build_seconds();
    json["sah_cost"] = info.sah_cost();
    json["tree_height"] = info.tree_height();
    json["refits"] = info.refits();
    json["rebuilds"] = info.rebuilds();
    json["last_edit"] = protocol::text(info.last_edit());
    json["kept"] = info.kept();
    json["nodes"] = info.nodes();
    json["leaf_blocks"] = info.leaf_blocks();
    json["tree_bytes"] = info.tree_bytes();
    json["bytes_per_triangle"] = bytes_per_triangle(info);
    json["origin"] = origin_of(info);
    json["up"] = protocol::word(info.up(), "y");
    json["box_min"] = corner(info, info.box_min());
    json["box_max"] = corner(info, info.box_max());
    json["cameras"] = protocol::strings(info.cameras());
    json["animations"] = protocol::strings(info.animations());
    json["animation_seconds"] = seconds_of(info);
    json["variants"] = protocol::strings(info.variants());
    json["variant"] = protocol::text(info.variant());
    json["skipped"] = counts_json(info.skipped_reasons(), info.skipped_counts());
    json["warnings"] = warnings(info);
    return json;
}

void print_scene(const wire::SceneInfo& info, const Json& epo) {
    std::vector<std::vector<std::string>> rows = {
        {"scene", std::string(protocol::text(info.name())) + " (epoch " +
                      std::to_string(info.epoch()) + ", " +
                      std::string(protocol::text(info.hash())) + ")"},
        {"triangles", grouped(info.unique_triangles()) + " unique, " +
                          grouped(info.instanced_triangles()) + " instanced"},
        {"box", box_text(info)},
        {"instances", grouped(info.instances()) + " on " + std::to_string(info.levels()) +
                          (info.levels() == 1 ? " level" : " levels")},
        {"materials", std::to_string(info.materials()) + ", " +
                          std::to_string(info.mask_materials()) + " MASK, " +
                          std::to_string(info.blend_materials()) + " BLEND"},
        {"intersector", info.intersector() != nullptr
                            ? "auto is " + std::string(protocol::text(info.intersector()))
                            : "none knows these primitives"},
        {"memory", bytes_text(info.bytes())},
        {"tree", tree_text(info, epo)},
        {"cameras", joined(numbered(protocol::strings(info.cameras())))},
    };
    if (std::vector<std::string> names = protocol::strings(info.animations()); !names.empty()) {
        const std::vector<double> seconds = seconds_of(info);
        for (std::size_t i = 0; i < names.size(); ++i)
            names[i] += " (" + Json(std::round(1000 * seconds[i]) / 1000).dump() + " s)";
        rows.push_back({"animations", joined(numbered(names))});
    }
    if (std::vector<std::string> names = protocol::strings(info.variants()); !names.empty()) {
        for (std::string& name : names)
            if (name == protocol::text(info.variant())) name += " (chosen)";
        rows.push_back({"variants", joined(names)});
    }
    if (protocol::text(info.up()) == "z") rows.push_back({"up", "z"});
    if (info.degenerate_triangles() != 0)
        rows.push_back({"degenerate", grouped(info.degenerate_triangles()) +
                                          " triangles without area, which nothing can hit"});
    if (const WorldPoint origin = origin_of(info); origin != WorldPoint{})
        rows.push_back({"origin", joined({Json(origin[0]).dump(), Json(origin[1]).dump(),
                                          Json(origin[2]).dump()})});
    const Json records = counts_json(info.record_types(), info.record_counts());
    for (const auto& [type, count] : records.items())
        rows.insert(rows.begin() + 2,
                    {"records", grouped(count.get<std::uint64_t>()) + " " + type});
    // Leave out triangles for a scene of other primitives.
    if (!records.empty() && info.unique_triangles() == 0) rows.erase(rows.begin() + 1);
    const Json skipped = counts_json(info.skipped_reasons(), info.skipped_counts());
    for (const auto& [reason, count] : skipped.items()) {
        rows.push_back({"skipped", skipped_text(reason, count.get<std::uint64_t>())});
    }
    for (const std::string& warning : warnings(info)) rows.push_back({"warning", warning});
    print_table(rows);
}

}  // namespace raynest::client

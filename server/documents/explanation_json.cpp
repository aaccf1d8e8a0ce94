#include "server/documents/explanation_json.h"

#include "server/documents/named_hit.h"

#include <cstddef>
#include <cstdio>

namespace raynest::server {
namespace {

constexpr std::array<const char*, entry_kinds> entry_kind_names = {"instance", "node", "leaf",
                                                                   "candidate"};
constexpr std::array<const char*, 5> outcome_names = {"accepted", "behind", "refused", "mask",
                                                      "back_face"};

/// "0.31", and more digits where a limit would read the same.
std::array<std::string, 2> short_numbers(float value, float limit) {
    std::array<std::string, 2> texts;
    for (const int digits : {3, 9}) {
        std::size_t i = 0;
        for (const float each : {value, limit}) {
            std::array<char, 32> text{};
            std::snprintf(text.data(), text.size(), "%.*g", digits, static_cast<double>(each));
            texts[i++] = text.data();
        }
        if (texts[0] != texts[1]) break;
    }
    return texts;
}

class ExplanationWriter {
public:
    ExplanationWriter(const Plan& plan, const ExplanationContext& context)
        : plan_(plan),
          context_(context),
          scene_(plan.scene.snapshot()),
          view_(scene_.view()),
          names_(scene_, context.limits.name_bytes_max) {}

    Json document(const Ray& ray, const Explanation& told) const {
        Json json{{"scene", plan_.scene.name},
                  {"hash", scene_.digest()},
                  {"epoch", plan_.scene.epoch},
                  {"intersector", plan_.variant->name},
                  {"target", plan_.variant->target}};
        if (!context_.camera.empty()) {
            json["camera"] = context_.camera;
            json["size"] = {context_.width, context_.height};
            json["pixel"] = context_.pixel;
        }
        json["ray"] = ray_json(ray, scene_.origin());
        json["hit"] = names_.hit(ray, told.hit);
        if (told.hit.hit != 0)
            json["hit"]["step"] = told.hit_entry == no_id ? Json(nullptr) : Json(told.hit_entry);
        json["totals"] = counters_json(told.totals);
        json["levels"] = Json::array();
        for (const Counters& level : told.levels) json["levels"].push_back(counters_json(level));
        json["steps"] = Json::array();
        for (const ExplainedEntry& entry : told.entries) json["steps"].push_back(step_json(entry));
        std::uint64_t left_out = 0;
        Json kinds = Json::object();
        for (std::size_t i = 0; i < entry_kinds; ++i) {
            left_out += told.left_out[i];
            kinds[entry_kind_names[i]] = told.left_out[i];
        }
        json["left_out"] = left_out;
        json["left_out_kinds"] = kinds;
        return json;
    }

private:
    Json step_json(const ExplainedEntry& entry) const {
        Json json{{"kind", entry_kind_names[static_cast<std::size_t>(entry.kind)]},
                  {"parent", entry.parent == no_id ? Json(nullptr) : Json(entry.parent)},
                  {"level", entry.level}};
        switch (entry.kind) {
            case EntryKind::instance:
                json["name"] = names_.placement(entry.placements, entry.level);
                json["mesh"] = names_.mesh(entry.object);
                json["path"] = entry.placements.first;
                json["placements"] = entry.placements.count;
                add_outcome(entry, json);
                break;
            case EntryKind::node:
                json["node"] = entry.place;
                json["boxes"] = entry.tested;
                json["entered"] = entry.passed;
                json["behind"] = entry.behind;
                json["refused"] = entry.refused;
                break;
            case EntryKind::leaf:
                json["leaf"] = entry.place;
                json["prims"] = entry.tested;
                json["hits"] = entry.passed;
                json["refused"] = entry.refused;
                break;
            case EntryKind::candidate:
                json.update(names_.primitive(entry.object, entry.place));
                json["t"] = number(entry.t);
                json["u"] = number(entry.u);
                json["v"] = number(entry.v);
                json["front"] = entry.front;
                add_outcome(entry, json);
                return json;
        }
        json["near"] = number(entry.near);
        json["box"] = world_box(entry.box, scene_.origin());
        return json;
    }

    void add_outcome(const ExplainedEntry& entry, Json& json) const {
        json["outcome"] = outcome_names[entry.outcome];
        if (entry.outcome != outcome_accepted) json["why"] = why(entry);
    }

    std::string why(const ExplainedEntry& entry) const {
        switch (entry.outcome) {
            case outcome_accepted:
                break;
            case outcome_behind:
                return "behind the best hit";
            case outcome_refused:
                return refusal_text(entry.refusal);
            case outcome_masked: {
                if ((view_.instances[entry.place].mask & plan_.mask) != 0)
                    return "hidden by the request";
                std::array<char, 64> text{};
                std::snprintf(text.data(), text.size(), "mask %X has no bit of the ray's %X",
                              view_.instances[entry.place].mask, plan_.mask);
                return text.data();
            }
            case outcome_culled:
                return "back face of a single-sided material, under cull=back";
        }
        return {};
    }

    std::string refusal_text(const Refusal& refusal) const {
        const std::string by = "refused by " + plan_.variant->name;
        if (refusal.what == nullptr) return by;
        if (refusal.relation == nullptr) return by + ": " + refusal.what;
        const auto [value, limit] = short_numbers(refusal.value, refusal.limit);
        return by + ": " + refusal.what + " " + value + " " + refusal.relation + " " + limit;
    }

    const Plan& plan_;
    const ExplanationContext& context_;
    const Snapshot& scene_;
    const SceneView& view_;
    const HitNames names_;
};

}  // namespace

std::string explanation_json(const Plan& plan, const ExplanationContext& context, const Ray& ray,
                             const Explanation& explanation) {
    return text_of(ExplanationWriter(plan, context).document(ray, explanation));
}

}  // namespace raynest::server

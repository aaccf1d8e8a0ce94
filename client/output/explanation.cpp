#include "client/output/explanation.h"

#include "client/ground/text.h"
#include "protocol/limits.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

namespace raynest::client {
namespace {

/// "3 leaves", "1 leaf".
std::string count_text(std::uint64_t count, const char* one, const char* many) {
    return grouped(count) + " " + (count == 1 ? one : many);
}

std::string number_text(const Json& number) {
    if (!number.is_number()) return "inf";
    std::array<char, 32> text{};
    std::snprintf(text.data(), text.size(), "%.6g", number.get<double>());
    return text.data();
}

std::string point_text(const Json& point) {
    std::string text;
    for (const Json& axis : point) text += (text.empty() ? "" : ",") + number_text(axis);
    return text;
}

std::string quoted(const Json& name) {
    return name.is_string() && !name.get<std::string>().empty()
               ? "'" + name.get<std::string>() + "'"
               : "without a name";
}

std::string primitive_text(const Json& step) {
    const std::string type = step.value("type", "triangle");
    std::string text = type + " " + grouped(step.at("prim").get<std::uint64_t>());
    if (type == "triangle")
        text += " of geometry " + std::to_string(step.at("geom").get<std::uint64_t>());
    if (step.at("material").is_string()) text += ", material " + quoted(step.at("material"));
    return text;
}

class Tree {
public:
    Tree(const Json& document, std::ostream& to)
        : steps_(document.at("steps")),
          hit_(document.at("hit").is_null() ? Json(nullptr) : document.at("hit").at("step")),
          to_(to),
          children_(steps_.size()) {
        for (std::size_t i = 0; i < steps_.size(); ++i) {
            const Json& parent = steps_[i].at("parent");
            // A parent comes before its children.
            if (parent.is_null())
                roots_.push_back(i);
            else if (const auto at = parent.get<std::size_t>(); at < i)
                children_[at].push_back(i);
        }
    }

    void print() {
        // Without recursion: a tree may be as deep as it has steps.
        std::vector<std::pair<std::size_t, std::size_t>> waiting;  // step, depth
        const auto push = [&](const std::vector<std::size_t>& steps, std::size_t depth) {
            for (std::size_t i = steps.size(); i-- > 0;) waiting.emplace_back(steps[i], depth);
        };
        push(roots_, 0);
        while (!waiting.empty()) {
            const auto [step, depth] = waiting.back();
            waiting.pop_back();
            std::array<char, 16> number{};
            std::snprintf(number.data(), number.size(), "%5zu  ", step);
            to_ << number.data() << std::string(2 * std::min<std::size_t>(depth, 60), ' ')
                << text_of(step) << '\n';
            push(children_[step], depth + 1);
        }
    }

private:
    std::string text_of(std::size_t index) const {
        const Json& step = steps_[index];
        const auto count = [&](const char* key) { return step.at(key).get<std::uint64_t>(); };
        const std::string kind = step.at("kind").get<std::string>();
        const auto refused = [&] {
            return count("refused") == 0 ? "" : ", " + grouped(count("refused")) + " refused";
        };
        if (kind == "node") {
            return "node " + std::to_string(count("node")) + ": " + grouped(count("entered")) +
                   " of " + count_text(count("boxes"), "box", "boxes") + " entered" +
                   (count("behind") == 0
                        ? ""
                        : ", " + grouped(count("behind")) + " of them left behind the best hit") +
                   refused();
        }
        if (kind == "leaf") {
            return "leaf " + std::to_string(count("leaf")) + ": " +
                   count_text(count("prims"), "primitive", "primitives") + " tested, " +
                   grouped(count("hits")) + " hit" + refused();
        }
        if (kind == "instance") {
            const std::string text = "instance " + quoted(step.at("name")) + " of mesh " +
                                     quoted(step.at("mesh")) + ", level " +
                                     std::to_string(count("level"));
            if (step.contains("why")) return text + ": not entered, " + why(step);
            return text + ", entered at t " + number_text(step.at("near"));
        }
        const std::string text = primitive_text(step) + ", t " + number_text(step.at("t")) + ": ";
        if (step.contains("why")) return text + why(step);
        return text + (hit_ == index ? "THE HIT" : "the best hit so far");
    }
    static std::string why(const Json& step) { return step.at("why").get<std::string>(); }

    const Json& steps_;
    const Json hit_;
    std::ostream& to_;
    std::vector<std::vector<std::size_t>> children_;
    std::vector<std::size_t> roots_;
};

std::string totals_text(const Json& totals) {
    const auto count = [&](const char* key) { return totals.at(key).get<std::uint64_t>(); };
    return "total " + grouped(count("total")) + " = " + count_text(count("boxes"), "box", "boxes") +
           " of " + count_text(count("nodes"), "node", "nodes") + " + " +
           count_text(count("prims"), "primitive", "primitives") + " of " +
           count_text(count("leaves"), "leaf", "leaves") + "; " +
           count_text(count("instances"), "instance", "instances") + " entered, " +
           count_text(count("rejects"), "candidate", "candidates") + " refused";
}

}  // namespace

void print_path(const Json& received, std::ostream& to) {
    const Json document = shown_json(received);
    to << "sample " << document.at("sample").get<std::uint64_t>() << " of pixel "
       << point_text(document.at("pixel")) << " of "
       << document.at("size").at(0).get<std::uint64_t>() << 'x'
       << document.at("size").at(1).get<std::uint64_t>() << " of camera "
       << quoted(document.at("camera")) << ", integrator "
       << document.at("integrator").get<std::string>() << ", seed "
       << document.at("seed").get<std::uint64_t>() << "\nscene "
       << document.at("scene").get<std::string>() << " epoch "
       << document.at("epoch").get<std::uint64_t>() << ", intersector "
       << document.at("intersector").get<std::string>() << " on "
       << document.at("target").get<std::string>() << "\nlight "
       << point_text(document.at("radiance")) << "\n\n";
    std::size_t number = 0;
    for (const Json& ray : document.at("rays")) {
        const auto bounce = ray.at("bounce").get<std::size_t>();
        const std::string kind = ray.at("kind").get<std::string>();
        std::array<char, 16> place{};
        std::snprintf(place.data(), place.size(), "%4zu  ", number++);
        to << place.data() << std::string(2 * std::min<std::size_t>(bounce, 60), ' ') << kind
           << " ray along " << point_text(ray.at("direction")) << ": ";
        const Json& hit = ray.at("hit");
        const std::string met =
            hit.is_null() ? ""
                          : quoted(hit.at("name")) + ", " + primitive_text(hit) + ", t " +
                                number_text(hit.at("t")) + ", at " + point_text(hit.at("position"));
        if (kind == "shadow")
            to << (!ray.at("blocked").get<bool>() ? "reaches the light"
                   : met.empty()                  ? "BLOCKED"
                                                  : "BLOCKED by " + met);
        else
            to << (met.empty() ? "leaves the scene" : "hits " + met);
        to << '\n';
    }
}

void print_explanation(const Json& received, std::ostream& to) {
    const Json document = shown_json(received);
    const Json& ray = document.at("ray");
    to << "ray from " << point_text(ray.at("origin")) << " along "
       << point_text(ray.at("direction")) << ", t " << number_text(ray.at("tmin")) << " to "
       << number_text(ray.at("tmax"));
    if (document.contains("pixel"))
        to << ", pixel " << point_text(document.at("pixel")) << " of "
           << document.at("size").at(0).get<std::uint64_t>() << 'x'
           << document.at("size").at(1).get<std::uint64_t>() << " of camera "
           << quoted(document.at("camera"));
    to << "\nscene " << document.at("scene").get<std::string>() << " epoch "
       << document.at("epoch").get<std::uint64_t>() << ", intersector "
       << document.at("intersector").get<std::string>() << " on "
       << document.at("target").get<std::string>() << '\n';
    const Json& hit = document.at("hit");
    if (hit.is_null())
        to << "no hit\n";
    else
        to << "hit " << quoted(hit.at("name")) << " of mesh " << quoted(hit.at("mesh")) << ", "
           << primitive_text(hit) << ", t " << number_text(hit.at("t")) << ", at "
           << point_text(hit.at("position")) << '\n';
    to << totals_text(document.at("totals")) << '\n';
    const Json& levels = document.at("levels");
    for (std::size_t level = 0; levels.size() > 1 && level < levels.size(); ++level)
        to << "  level " << level << ": " << totals_text(levels[level]) << '\n';
    to << '\n';
    Tree(document, to).print();
    const auto left_out = document.at("left_out").get<std::uint64_t>();
    if (left_out == 0) return;
    std::string kinds;
    for (const auto& [kind, one, many] :
         {std::array{"instance", "instance", "instances"}, std::array{"node", "node", "nodes"},
          std::array{"leaf", "leaf", "leaves"},
          std::array{"candidate", "candidate", "candidates"}}) {
        const auto count = document.at("left_out_kinds").at(kind).get<std::uint64_t>();
        if (count != 0) kinds += (kinds.empty() ? "" : ", ") + count_text(count, one, many);
    }
    to << "... " << count_text(left_out, "more step is", "more steps are") << " left out: " << kinds
       << "; --all shows up to " << grouped(protocol::Limits{}.explain_steps_max) << '\n';
}

}  // namespace raynest::client

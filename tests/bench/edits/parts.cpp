#include "tests/bench/edits/parts.h"

#include "engine/scene/edits/batch.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/names.h"
#include "tests/bench/edits/measured.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace raynest::bench {
namespace {

using Scene = std::shared_ptr<const Snapshot>;

Transform at(float x, float y, float z) {
    return {{1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z}};
}

/// Makes edits one after the other, each in the memory of the one before the last.
class Editor {
public:
    explicit Editor(Scene scene) : scene_(std::move(scene)) {}

    [[nodiscard]] const Snapshot& scene() const { return *scene_; }
    void edit(const SceneChanges& changes) {
        auto next = edit_scene(*scene_, changes, std::move(before_));
        if (!next) throw std::runtime_error(next.error().message);
        before_ = std::exchange(scene_, std::move(*next));
    }

private:
    Scene scene_, before_;
};

ObjectDescription triangle() {
    ObjectDescription object;
    object.name = "part";
    object.geometries.resize(1);
    object.geometries[0].positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    object.geometries[0].indices = {0, 1, 2};
    return object;
}

InstanceDescription part(const Transform& transform) {
    InstanceDescription one;
    one.object = 0;
    one.transform = transform;
    return one;
}

/// Parts that lie anywhere in a cube.
std::vector<InstanceDescription> cloud(std::uint32_t count) {
    std::mt19937 random(count);
    std::uniform_real_distribution<float> place(0, 1000);
    std::vector<InstanceDescription> parts;
    for (std::uint32_t i = 0; i < count; ++i)
        parts.push_back(part(at(place(random), place(random), place(random))));
    return parts;
}

/// All parts of the field end at the same height.
nlohmann::json flat_field(std::uint32_t count) {
    const auto side = static_cast<std::uint32_t>(std::sqrt(static_cast<double>(count))) + 1;
    const auto place = [&](std::uint32_t i, float shift) {
        return at(2 * static_cast<float>(i % side), 0, 2 * static_cast<float>(i / side) + shift);
    };
    SceneDescription description;
    description.objects = {triangle(), {}};
    for (std::uint32_t i = 0; i < count; ++i)
        description.objects[1].instances.push_back(part(place(i, 0)));
    description.root = 1;
    const double build = best_of(3, [&](int) { built(description); });
    Editor editor(built(description));
    constexpr std::uint32_t tries = 100;
    std::vector<double> costs;
    for (std::uint32_t i = 0; i <= tries; ++i) {
        // Those behind the others are the farthest from the origin, and have the largest padding.
        const std::uint32_t which = i % 2 == 0 ? count - 1 - i : count / tries * i;
        const double cost = best_of(3, [&](int round) {
            editor.edit({{{which, place(which, 0.001F * static_cast<float>(round))}}});
        });
        if (i != 0) costs.push_back(cost);
    }
    std::ranges::sort(costs);
    return {{"build_cpu_seconds", build},
            {"move_median_over_build", costs[costs.size() / 2] / build},
            {"move_worst_over_build", costs.back() / build}};
}

/// CPU seconds of the move of one part in a group that the scene places twice.
double nested_move(std::uint32_t count, int rounds) {
    SceneDescription description;
    description.objects = {triangle(), {}, {}};
    description.objects[1].instances = cloud(count);
    for (const float x : {0.0F, 2000.0F}) {
        InstanceDescription group = part(at(x, 0, 0));
        group.object = 1;
        description.objects[2].instances.push_back(group);
    }
    description.root = 2;
    Editor editor(built(description));
    const auto move = [&](int round) {
        const Transform to = at(500 + 0.001F * static_cast<float>(round), 500, 500);
        editor.edit({{{{0, {count / 2}}, to}}});
    };
    for (int i = 0; i < 3; ++i) move(i);  // the first one gives the places groups of their own
    return best_of(rounds, move);
}

/// CPU seconds of the move of one part that is named by its number or its text.
double named_move(std::uint32_t count, int rounds, bool by_text) {
    SceneDescription description;
    description.objects = {triangle(), {}};
    description.objects[1].instances = cloud(count);
    description.root = 1;
    Editor editor(built(description));
    const auto move = [&](int round) {
        const std::uint32_t which = count - 1 - static_cast<std::uint32_t>(round % 7);
        InstancePlace place(which);
        if (by_text)
            place = InstanceFinder(editor.scene(), [] { return false; })
                        .find(fmt::format("part#{}", which))
                        ->front();
        EditBatch batch(editor.scene());
        batch.move(place, translation_by({0, 0, 0.001}), EditFrame::parent);
        editor.edit(batch.changes());
    };
    for (int i = 0; i < 3; ++i) move(i);
    return best_of(rounds, move);
}

}  // namespace

nlohmann::json part_figures(std::uint32_t count, int rounds) {
    nlohmann::json nested, named;
    for (const std::uint32_t siblings : {count / 100, count / 10, count})
        nested[std::to_string(siblings)] = nested_move(siblings, rounds);
    for (const std::uint32_t siblings : {10'000U, 10 * count})
        named[std::to_string(siblings)] = {
            {"by_number", named_move(siblings, rounds, false)},
            {"by_text", named_move(siblings, rounds, true)},
        };
    return {{"flat_field", flat_field(count)},
            {"nested_move_cpu_seconds", nested},
            {"move_cpu_seconds", named}};
}

}  // namespace raynest::bench

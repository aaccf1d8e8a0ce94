// The box of a scene after edits: that of the same scene, built afresh.
#include "engine/scene/edits/edit.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

using namespace raynest;
using conformance::Random;
using test::build_scene;
using test::place;
using test::translation;

TEST_CASE("parts that share sides of the scene's box leave and reach them") {
    Random random(5);
    SceneDescription description;
    description.objects.resize(2);
    description.objects[0].geometries.push_back(test::unit_square());
    auto& placed = description.objects[1].instances;
    const auto at = [&](float reach) {
        const auto step = [&] { return reach * static_cast<float>(random.below(20)); };
        const float height = random.below(6) == 0 ? random.between(-2, 2) : 0;
        return translation(step(), step(), height);
    };
    for (int i = 0; i < 300; ++i) placed.push_back(place(0, at(2)));
    description.root = 1;
    std::shared_ptr<const Snapshot> scene = build_scene(description);
    for (int step = 0; step < 150; ++step) {
        CAPTURE(step);
        std::vector<InstanceMove> moves;
        for (std::uint32_t i = random.below(3) + 1; i-- > 0;) {
            const std::uint32_t which = 100 * i + random.below(100);
            placed[which].transform = at(random.below(9) == 0 ? 3 : 2);
            moves.push_back({which, placed[which].transform});
        }
        const auto edited = edit_scene(*scene, {std::move(moves), {}, {}, {}});
        REQUIRE_MESSAGE(edited, edited.error().message);
        scene = *edited;
        const auto fresh = build_scene(description);
        CHECK(scene->bounds().lower == fresh->bounds().lower);
        CHECK(scene->bounds().upper == fresh->bounds().upper);
    }
}

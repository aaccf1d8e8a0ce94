#include "server/store/scene_store.h"

#include "server/handlers/scene_info.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

using test::build_scene;

std::shared_ptr<const Snapshot> square(float size) {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {test::unit_square()};
    for (Vec3& p : scene.objects[0].geometries[0].positions) p *= size;
    return build_scene(scene);
}

/// Returns a connection of this principal, the same one for the same number.
ConnectionId of(const std::string& principal, std::uint64_t connection = 1) {
    return {principal, connection};
}

TEST_CASE("other content under a taken name needs replace, and is a new epoch") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const auto first = store.publish("a", square(1), {}, of("me"));
    REQUIRE(first);
    CHECK(first->epoch == 1);
    CHECK(store.publish("a", square(1), {}, of("me"))->epoch == 1);

    const auto taken = store.publish("a", square(2), {}, of("me"));
    REQUIRE_FALSE(taken);
    CHECK(taken.error().code == Code::name_taken);
    const auto second = store.publish("a", square(2), {.replace = true}, of("me"));
    REQUIRE(second);
    CHECK(second->epoch == 2);
    CHECK(store.find("a", 2, of("me")));
    CHECK(store.find("a", 0, of("me"))->epoch == 2);
    const auto old = store.find("a", 1, of("me"));
    REQUIRE_FALSE(old);
    CHECK(old.error().code == Code::scene_unknown);
    // A holder of the first scene still has it.
    CHECK(first->snapshot().bounds().upper.x == 1);
}

TEST_CASE("equal content is held once, and memory returns with the last holder") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    auto running = store.publish("a", square(1), {}, of("me"));
    const std::uint64_t used = budget.used();
    CHECK(used > 0);
    CHECK(store.publish("b", square(1), {}, of("me")));
    CHECK(budget.used() == used);
    CHECK(store.list(of("me")).size() == 2);
    CHECK(store.unload("a", of("me")));
    CHECK(store.unload("b", of("me")));
    CHECK(budget.used() == used);
    CHECK(store.holds(running->snapshot().digest()));
    running = refuse(Code::cancelled, "");
    CHECK(budget.used() == 0);
}

TEST_CASE("a scene stays until its last owner unloads it") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    REQUIRE(store.publish("a", square(1), {}, of("me")));
    REQUIRE(store.publish("a", square(1), {}, of("you", 2)));
    CHECK(store.list(of("me")).at(0).owner == "me");
    CHECK(store.unload("a", of("stranger", 3)).error().code == Code::not_allowed);
    const auto mine = store.unload("a", of("me"));
    REQUIRE(mine);
    CHECK(*mine == std::vector<std::string>{"you (by its name)", "you (1 connection)"});
    CHECK(store.find("a", 0, of("me")));
    // The error and the list name who still owns it, not who loaded it.
    CHECK(store.unload("a", of("me")).error().message.find("belongs to you;") != std::string::npos);
    CHECK(store.list(of("me")).at(0).owner == "you");
    CHECK(store.unload("a", of("you", 2))->empty());
    CHECK(store.find("a", 0, of("you", 2)).error().code == Code::scene_unknown);
    CHECK(store.unload("a", of("you", 2)).error().code == Code::scene_unknown);
}

TEST_CASE("scenes that others hold too are not replaced") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    REQUIRE(store.publish("a", square(1), {}, of("me")));
    CHECK(store.publish("a", square(2), {.replace = true}, of("you")).error().code ==
          Code::not_allowed);
    REQUIRE(store.publish("a", square(1), {}, of("you")));
    CHECK(store.publish("a", square(2), {.replace = true}, of("me")).error().code ==
          Code::not_allowed);
    CHECK(store.find("a", 0, of("me"))->epoch == 1);
    REQUIRE(store.unload("a", of("me")));
    CHECK(store.publish("a", square(2), {.replace = true}, of("you"))->epoch == 2);
}

TEST_CASE("a scene beyond the budget is refused, and the name stays as it was") {
    const std::uint64_t bytes = square(1)->bytes().size();
    Budget budget(bytes + bytes / 2);
    SceneStore store(budget);
    REQUIRE(store.publish("a", square(1), {}, of("me")));
    CHECK(store.publish("a", square(2), {.replace = true}, of("me")).error().code ==
          Code::resource_exhausted);
    CHECK(store.find("a", 0, of("me"))->epoch == 1);
    CHECK(store.publish("b", square(2), {}, of("me")).error().code == Code::resource_exhausted);
    CHECK(store.list(of("me")).size() == 1);
}

TEST_CASE("names from a file are made safe to send, and long lists are cut with a note") {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {test::unit_square()};
    for (int i = 0; i < 2000; ++i) {
        CameraDescription camera;
        camera.name = std::string(300, i % 2 == 0 ? '\x01' : '\xff') + std::to_string(i);
        scene.cameras.push_back(camera);
    }
    scene.warnings.assign(50, std::string(5000, 'w'));
    Budget budget(1 << 30);
    SceneStore store(budget);
    const auto named = store.publish("a", build_scene(scene), {}, of("me"));
    REQUIRE(named);
    const protocol::Limits limits;
    const auto frame = protocol::encode(1, scene_info(*named, limits), limits);
    REQUIRE(frame);
    const auto info = protocol::open<wire::SceneInfo>(*frame, limits);
    REQUIRE(info);
    CHECK((*info)->cameras()->size() > 10);
    const auto* warnings = (*info)->warnings();
    CHECK(warnings->Get(warnings->size() - 1)->str().find("more cameras") != std::string::npos);
}

TEST_CASE("text is cut between characters") {
    CHECK(clean_text("abc", 2) == "ab");
    CHECK(clean_text("a\xc3\xa4", 2) == "a");
    CHECK(clean_text("a\xc3\xa4", 3) == "a\xc3\xa4");
    CHECK(clean_text("a\x1b[2J", 9) == "a?[2J");
}

TEST_CASE("what makes room is true: nobody unloads where nothing is loaded") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    CHECK(store.remedy("me", "--memory") == "start raynestd with a larger --memory");
    REQUIRE(store.publish("a", square(1), {}, of("me")));
    for (const char* word : {"raynest unload NAME", "'a'", "a larger --memory"})
        CHECK(store.remedy("me", "--memory").find(word) != std::string::npos);
    CHECK(store.remedy("you", "--memory").find("raynest unload") == std::string::npos);
}

TEST_CASE("a principal's scenes are limited in number and bytes") {
    Budget budget(1 << 30);
    protocol::Limits limits;
    limits.principal_scenes_max = 2;
    SceneStore store(budget, limits);
    REQUIRE(store.publish("a", square(1), {}, of("me")));
    REQUIRE(store.publish("b", square(2), {}, of("me")));
    const auto third = store.publish("c", square(3), {}, of("me"));
    REQUIRE_FALSE(third);
    CHECK(third.error().code == Code::quota);
    CHECK(third.error().message.find("--principal-scenes-max 2; ") != std::string::npos);
    CHECK_FALSE(store.check_quota("c", of("me"), 0));
    // A held scene may change, others may load, and unloading makes room.
    CHECK(store.publish("b", square(3), {.replace = true}, of("me")));
    CHECK(store.publish("c", square(3), {}, of("you")));
    CHECK_FALSE(store.publish("c", square(3), {}, of("me")));
    CHECK(store.unload("a", of("me")));
    CHECK(store.publish("c", square(3), {}, of("me")));

    limits.principal_scenes_max = 10;
    limits.principal_scene_bytes_max = square(1)->bytes().size() + 1;
    SceneStore small(budget, limits);
    REQUIRE(small.publish("a", square(1), {}, of("me")));
    const auto second = small.publish("b", square(2), {}, of("me"));
    REQUIRE_FALSE(second);
    CHECK(second.error().code == Code::quota);
    CHECK(second.error().message.find("--principal-scene-bytes-max") != std::string::npos);
    CHECK(small.publish("a", square(2), {.replace = true}, of("me")));
}

}  // namespace
}  // namespace raynest::server

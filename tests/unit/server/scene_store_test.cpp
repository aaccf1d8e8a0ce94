#include "server/store/scene_store.h"

#include "engine/assets/builtin/builtin.h"
#include "engine/packs/registry.h"
#include "engine/scene/edits/edit.h"
#include "server/documents/scene_info.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <vector>

namespace raynest::server {
namespace {

using test::build_scene;

using test::square;

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

TEST_CASE(
    "an edit is the next epoch of its owner's scene, and of the epoch that it was made of alone") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const auto first = store.publish("a", square(1), {.share = {"you"}}, of("me"));
    REQUIRE(first);
    auto edited = store.publish_edit(*first, square(2), of("me"));
    REQUIRE(edited);
    REQUIRE(*edited);
    CHECK((*edited)->epoch == 2);
    CHECK(store.find("a", 0, of("me"))->epoch == 2);
    CHECK(store.find("a", 0, of("you", 2))->epoch == 2);
    CHECK(first->snapshot().bounds().upper.x == 1);

    // Made of an epoch that is not the present one: nothing is published.
    const auto late = store.publish_edit(*first, square(3), of("me"));
    REQUIRE(late);
    CHECK(!*late);
    CHECK(store.find("a", 0, of("me"))->epoch == 2);

    auto shared = *store.find("a", 0, of("you", 2));
    CHECK(store.may_edit("me/a", of("you", 2)).error().code == Code::not_allowed);
    CHECK(store.publish_edit(shared, square(3), of("you", 2)).error().code == Code::not_allowed);
    CHECK(store.may_edit("a", of("stranger", 3)).error().code == Code::scene_unknown);
    CHECK(store.may_edit("me/a", {"root", 4, Role::admin}));
    REQUIRE(store.publish_edit(shared, square(4), {"root", 4, Role::admin}));
    CHECK(store.find("a", 0, of("me"))->epoch == 3);
    // The epoch before the last edit is kept for the next one, unless anybody reads it.
    auto now = *store.find("a", 0, of("me"));
    CHECK(store.take_spare(now, of("me")) == nullptr);  // `shared` is that epoch
    REQUIRE(store.publish_edit(now, square(5), of("me")));
    const std::uint64_t used = budget.used();
    now = {};
    CHECK(budget.used() == used);
    shared = {};
    edited->reset();
    CHECK(budget.used() < used);
    CHECK(store.take_spare(*store.find("a", 0, of("me")), of("me"))->bounds().upper.x == 4);
    REQUIRE(store.publish_edit(*store.find("a", 0, of("me")), square(6), of("me")));
    const std::uint64_t kept = budget.used();
    store.drop_spares();
    CHECK(budget.used() < kept);
}

TEST_CASE("memory that epochs share is counted once, as long as one of them is there") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const auto forest = *Snapshot::build(*describe_builtin("builtin:forest?trees=3000"));
    const std::uint64_t whole = forest->bytes().size();
    std::vector<NamedScene> held{*store.publish("a", forest, {}, of("me"))};
    for (std::uint32_t i = 0; i < 40; ++i) {
        const SceneView& view = held.back().snapshot().view();
        Transform to = view.instance_infos[view.objects[view.root].first_instance + i].to_parent;
        to.m[7] += 1;
        const auto edited = edit_scene(held.back().snapshot(), {{{i, to}}, {}, {}, {}});
        REQUIRE(edited);
        held.push_back(**store.publish_edit(held.back(), *edited, of("me")));
        std::uint64_t counted = held.size() > 2 ? whole : 0;
        for (const NamedScene& epoch : held) counted += epoch.snapshot().own_bytes();
        CHECK(budget.used() == counted);
        CHECK(store.bytes() == counted);
    }
    CHECK(budget.used() < 20 * whole);
    held.erase(held.begin(), held.end() - 1);
    CHECK(store.unload("a", of("me")));
    CHECK(budget.used() == whole + held[0].snapshot().own_bytes());
    held.clear();
    CHECK(budget.used() == 0);
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
    CHECK(store.holds(running->snapshot().arena_id()));
    running = refuse(Code::cancelled, "");
    CHECK(budget.used() == 0);
}

TEST_CASE("two owners each have a scene of one name") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const std::uint64_t epoch = store.publish("car", square(1), {}, of("me"))->epoch;
    REQUIRE(store.publish("car", square(2), {}, of("you", 2)));
    CHECK(store.find("car", 0, of("me"))->snapshot().bounds().upper.x == 1);
    CHECK(store.find("car", 0, of("you", 2))->snapshot().bounds().upper.x == 2);
    CHECK(store.find("me/car", 0, of("me"))->name == "car");
    // Each replaces and unloads its own.
    CHECK(store.publish("car", square(3), {.replace = true}, of("you", 2))->epoch == epoch + 1);
    CHECK(store.unload("car", of("you", 2))->empty());
    CHECK(store.find("car", 0, of("me"))->epoch == epoch);
    CHECK_FALSE(store.find("car", 0, of("you", 2)));
}

TEST_CASE("a private scene is for others like one that does not exist") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const auto mine = store.publish("car", square(1), {}, of("me"));
    REQUIRE(mine);
    const ConnectionId other = of("you", 2);
    for (const char* name : {"car", "me/car"}) {
        const auto hidden = store.find(name, 0, other);
        const auto unknown = store.find(std::string(name) == "car" ? "cab" : "me/cab", 0, other);
        REQUIRE_FALSE(hidden);
        CHECK(hidden.error().code == unknown.error().code);
        std::string text = unknown.error().message;
        text.replace(text.find("cab"), 3, "car");
        CHECK(hidden.error().message == text);
        CHECK(store.unload(name, other).error().code == Code::scene_unknown);
        CHECK(store.open(name, other).error().code == Code::scene_unknown);
    }
    CHECK(store.list(other).empty());
    CHECK_FALSE(store.shows(mine->snapshot().digest(), other));
    // Equal content of another owner takes no memory, and is told to nobody.
    const std::uint64_t used = budget.used();
    REQUIRE(store.publish("van", square(1), {}, other));
    CHECK(budget.used() == used);
    CHECK(store.shows(mine->snapshot().digest(), other));
}

TEST_CASE("the digest of an upload finds a scene for those alone who may see it") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const ConnectionId me = of("me"), you = of("you", 2), root{"root", 9, Role::admin};
    REQUIRE(store.publish("car", square(1), {.made_of = "files"}, me));
    const auto mine = store.find_made_of("files", me);
    REQUIRE(mine);
    CHECK(mine->snapshot->bounds().upper.x == 1);
    CHECK(store.find_made_of("files", root) == mine);
    CHECK_FALSE(store.find_made_of("files", you));
    CHECK_FALSE(store.find_made_of("others", me));

    // Equal content, of no upload
    REQUIRE(store.publish("car", square(1), {.share = {"you"}}, me));
    CHECK(store.find_made_of("files", you) == mine);
    REQUIRE(store.publish("car", square(2), {.replace = true}, me));
    CHECK_FALSE(store.find_made_of("files", me));
    REQUIRE(store.publish("car", square(3), {.replace = true, .made_of = "files"}, me));
    CHECK(store.find_made_of("files", me)->snapshot->bounds().upper.x == 3);
    CHECK(store.unload("car", me));
    CHECK_FALSE(store.find_made_of("files", me));
}

TEST_CASE("a shared scene is found by those whom it is shared with") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const ConnectionId you = of("you", 2), them = of("them", 3);
    REQUIRE(store.publish("car", square(1), {.share = {"you"}}, of("me")));
    CHECK(store.find("me/car", 0, you)->name == "me/car");
    CHECK(store.find("car", 0, you)->name == "me/car");
    CHECK_FALSE(store.find("me/car", 0, them));
    CHECK(store.list(you).at(0).share == "you");
    CHECK(store.unload("me/car", you).error().code == Code::not_allowed);

    // A name without owner means neither of two shared scenes; one's own comes first.
    REQUIRE(store.publish("car", square(2), {.share = {"public"}}, them));
    const auto several = store.find("car", 0, you);
    REQUIRE_FALSE(several);
    CHECK(several.error().message.find("me/car") != std::string::npos);
    CHECK(several.error().message.find("them/car") != std::string::npos);
    REQUIRE(store.publish("car", square(3), {}, you));
    CHECK(store.find("car", 0, you)->name == "car");
    // A load without `share` leaves it as it was; another list replaces it.
    REQUIRE(store.publish("car", square(1), {}, of("me")));
    CHECK(store.find("me/car", 0, you));
    REQUIRE(store.publish("car", square(1), {.share = {"nobody"}}, of("me")));
    CHECK_FALSE(store.find("me/car", 0, you));
}

TEST_CASE("whom a new share leaves out sees nothing any more, also who held the scene") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const ConnectionId you = of("you", 2), them = of("them", 3);
    REQUIRE(store.publish("car", square(1), {.share = {"you", "them"}}, of("me")));
    for (const ConnectionId& holder : {you, them}) REQUIRE(store.open("me/car", holder));
    REQUIRE(store.publish("car", square(2), {.replace = true, .share = {"them"}}, of("me")));
    CHECK(store.find("me/car", 0, you).error().code == Code::scene_unknown);
    CHECK(store.find("me/car", 0, them));
    CHECK(*store.unload("car", of("me")) == std::vector<std::string>{"them (1 connection)"});
}

TEST_CASE("whom a scene is shared with is told in few bytes") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    std::vector<std::string> many;
    for (int i = 0; i < 512; ++i) many.push_back(std::to_string(1000 + i) + std::string(100, ','));
    REQUIRE(store.publish("car", square(1), {.share = many}, of("me")));
    const std::string told = store.list(of("me")).at(0).share;
    CHECK(told.size() < 1100);
    CHECK(told.ends_with(" more"));
}

TEST_CASE("an administrator sees and unloads every scene") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    REQUIRE(store.publish("car", square(1), {}, of("me")));
    const ConnectionId root{"root", 9, Role::admin};
    CHECK(store.find("car", 0, root)->name == "me/car");
    CHECK(store.list(root).size() == 1);
    CHECK(*store.unload("me/car", root) == std::vector<std::string>{"me (1 connection)"});
    store.disconnect(of("me"));
    CHECK(budget.used() == 0);
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
    const auto registry = Registry::load({}).value();
    const auto frame = protocol::encode(1, scene_info(*named, *registry, limits), limits);
    REQUIRE(frame);
    const auto info = protocol::open<wire::SceneInfo>(*frame, limits);
    REQUIRE(info);
    CHECK((*info)->cameras()->size() > 10);
    const auto* warnings = (*info)->warnings();
    CHECK(warnings->Get(warnings->size() - 1)->str().find("more cameras") != std::string::npos);
}

TEST_CASE("an administrator who names a scene of several owners is told so, whatever he asks") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    for (const char* owner : {"bob", "carol"})
        REQUIRE(store.publish("car", square(1), {}, of(owner)));
    ConnectionId admin = of("root");
    admin.role = Role::admin;
    for (const auto& why :
         {store.find("car", 0, admin).error(), store.unload("car", admin).error()}) {
        CHECK(why.code == Code::scene_unknown);
        CHECK(why.message == "several owners have a scene 'car'; name one of bob/car, carol/car");
    }
    CHECK(store.unload("bob/car", admin));
    CHECK(store.unload("car", admin));
    // Others learn nothing of scenes that they may not see.
    REQUIRE(store.publish("car", square(1), {}, of("bob")));
    CHECK(store.unload("car", of("dave")).error().message ==
          store.unload("cab", of("dave")).error().message.replace(7, 3, "car"));
}

TEST_CASE("what makes room is true: nobody unloads where nothing is loaded") {
    Budget budget(1 << 30);
    SceneStore store(budget);
    const std::string larger = "start raynestd with a larger --memory";
    CHECK(store.remedy("me", larger) == larger);
    REQUIRE(store.publish("a", square(1), {}, of("me")));
    for (const char* word : {"raynest unload NAME", "'a'", "a larger --memory"})
        CHECK(store.remedy("me", larger).find(word) != std::string::npos);
    CHECK(store.remedy("you", larger).find("raynest unload") == std::string::npos);
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

TEST_CASE("the connections of a principal hold so many scenes in all, each counted by each") {
    Budget budget(1 << 30);
    protocol::Limits limits;
    limits.principal_holds_max = 3;
    SceneStore store(budget, limits);
    REQUIRE(store.publish("a", square(1), {.share = {"public"}}, of("you", 1)));
    for (std::uint64_t connection = 2; connection < 5; ++connection)
        REQUIRE(store.open("a", of("me", connection)));
    const auto fourth = store.open("a", of("me", 5));
    REQUIRE_FALSE(fourth);
    CHECK(fourth.error().code == Code::quota);
    CHECK(fourth.error().message.find("principal_holds_max = 3") != std::string::npos);
    CHECK(store.check_quota("b", of("me", 5), 0).error().code == Code::quota);
    // One that holds it asks again, others have holds of their own, and one that ends makes room.
    CHECK(store.open("a", of("me", 2)));
    CHECK(store.open("a", of("them", 5)));
    REQUIRE(store.unload("a", of("me", 3)));
    CHECK(store.open("a", of("me", 5)));
}

TEST_CASE("loads between their check and their entry count towards the quotas of their owner") {
    Budget budget(1 << 30);
    protocol::Limits limits;
    limits.principal_scenes_max = 2;
    SceneStore store(budget, limits);
    auto first = store.prepare_to_store("a", square(1), {}, of("me"));
    REQUIRE(first);
    auto second = store.prepare_to_store("b", square(2), {}, of("me", 2));
    REQUIRE(second);
    const auto third = store.prepare_to_store("c", square(3), {}, of("me", 3));
    REQUIRE_FALSE(third);
    CHECK(third.error().code == Code::quota);
    CHECK(store.check_quota("c", of("me"), 0).error().code == Code::quota);
    CHECK(store.publish("c", square(3), {}, of("me", 3)).error().code == Code::quota);
    CHECK(store.prepare_to_store("c", square(3), {}, of("you", 4)));
    second->claim.reset();  // it ended without a scene
    CHECK(store.publish("c", square(3), {}, of("me", 3)));
    // Memory of scenes, likewise.
    limits.principal_scenes_max = 10;
    limits.principal_scene_bytes_max = 3 * square(1)->bytes().size();
    store.set_limits(limits);
    CHECK(store.prepare_to_store("d", square(4), {}, of("me")));
    auto last = store.prepare_to_store("d", square(4), {}, of("me"));
    REQUIRE(last);
    CHECK(store.prepare_to_store("e", square(5), {}, of("me")).error().code == Code::quota);
}

}  // namespace
}  // namespace raynest::server

// Tests the holders of a scene: names, and the connections that loaded or opened it.
#include "server/store/scene_store.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <ctime>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using Names = std::vector<std::string>;

using test::square;

float size_of(const Reply<NamedScene>& scene) {
    return scene->snapshot().bounds().upper.x;
}

struct Store {
    Budget budget{1 << 30};
    protocol::Limits limits;
    SceneStore::Clock::time_point now{std::chrono::hours(1)};
    SceneStore scenes{budget, limits, [this] { return now; }};
    // Two programs of one principal, and one of another.
    const ConnectionId a{"me", scenes.connect()};
    const ConnectionId b{"me", scenes.connect()};
    const ConnectionId stranger{"you", scenes.connect()};

    const Publication shared{.share = {"public"}};

    [[nodiscard]] Names names(const ConnectionId& caller) const {
        Names names;
        for (const auto& listed : scenes.list(caller)) names.push_back(listed.scene.name);
        return names;
    }
};

TEST_CASE("nobody's room tells whether others have the same content, unless it sees their scene") {
    const auto left_after_load = [](const Publication& theirs, bool is_there, Use use) {
        Store store;
        const auto others = square(is_there ? 1 : 2);
        REQUIRE(store.scenes.publish("theirs", others, theirs, store.a));
        const std::uint64_t before = store.budget.room("you", use);
        const std::uint64_t told = store.budget.used() + store.budget.unpaid();
        REQUIRE(store.scenes.publish("mine", square(1), {}, store.stranger));
        const std::uint64_t takes = store.budget.used() + store.budget.unpaid() - told;
        const std::uint64_t less = before - store.budget.room("you", use);
        // Letting go of it takes nothing else along.
        store.scenes.disconnect(store.stranger);
        REQUIRE(store.scenes.unload("mine", store.stranger));
        CHECK(store.budget.room("you", use) == before);
        CHECK(store.budget.unpaid() == 0);
        return std::pair(less, takes);
    };
    for (const Use use : {Use::lasting, Use::passing}) {
        const auto alone = left_after_load({}, false, use);
        CHECK(alone.second >= square(1)->bytes().size());
        CHECK(left_after_load({}, true, use) == alone);
        CHECK(left_after_load({.share = {"others"}}, true, use) == alone);
        CHECK(left_after_load({.share = {"public"}}, true, use) == std::pair{0UL, 0UL});
        CHECK(left_after_load({.share = {"you"}}, true, use) == std::pair{0UL, 0UL});
    }
}

TEST_CASE("unloading takes nothing from another connection, and its name works on there") {
    Store store;
    SceneStore& scenes = store.scenes;
    REQUIRE(scenes.publish("town", square(1), store.shared, store.a));
    REQUIRE(scenes.open("town", store.b));
    REQUIRE(scenes.open("town", store.stranger));
    const auto holders = scenes.unload("town", store.a);
    REQUIRE(holders);
    CHECK(*holders == Names{"me (1 connection)", "you (1 connection)"});
    CHECK(scenes.find("town", 0, store.a).error().code == Code::scene_unknown);
    CHECK(size_of(scenes.find("town", 0, store.b)) == 1);
    CHECK(scenes.unlisted().scenes == 1);

    // The name is free: others can load another scene under it, for all but the holders of the
    // first.
    REQUIRE(scenes.publish("town", square(2), {}, store.a));
    CHECK(size_of(scenes.find("town", 0, store.a)) == 2);
    CHECK(size_of(scenes.find("town", 0, store.b)) == 1);
    CHECK(size_of(scenes.find("town", 0, store.stranger)) == 1);
    CHECK(store.names(store.b) == Names{"town"});

    // The last holder of the first scene frees its memory.
    const std::uint64_t both = store.budget.used();
    scenes.disconnect(store.b);
    CHECK(store.budget.used() == both);
    scenes.disconnect(store.stranger);
    CHECK(store.budget.used() < both);
    CHECK(scenes.unlisted().scenes == 0);
    CHECK(size_of(scenes.find("town", 0, store.b)) == 2);
}

/// More of them take more bytes.
std::shared_ptr<const Snapshot> many_squares(int count) {
    SceneDescription scene = test::tree_scene();
    for (int i = 0; i < count; ++i)
        scene.objects[scene.root].instances.push_back(
            test::place(0, test::translation(30.0F + static_cast<float>(i), 0, 0)));
    return test::build_scene(scene);
}

TEST_CASE("a holder is charged for what it opened, whatever the owner puts in its place") {
    Store store;
    SceneStore& scenes = store.scenes;
    const std::uint64_t small = many_squares(0)->bytes().size();
    const std::uint64_t large = many_squares(200)->bytes().size();
    REQUIRE(large > 2 * small);
    store.limits.principal_scene_bytes_max = large + small;
    scenes.set_limits(store.limits);
    const auto used = [&](const char* who) { return scenes.usage_of({who}).at(who).bytes; };
    REQUIRE(scenes.publish("town", many_squares(0), store.shared, store.a));
    REQUIRE(scenes.open("town", store.stranger));
    CHECK(used("you") == small);
    REQUIRE(scenes.publish("town", many_squares(200), {.replace = true}, store.a));
    CHECK(used("me") == large);
    CHECK(used("you") == small);
    CHECK(scenes.find("me/town", 0, store.stranger)->snapshot().bytes().size() == large);
    // Its own loads have as much room as before.
    CHECK(scenes.check_quota("mine", store.stranger, large));
    // To open what stands there now is to agree to its bytes.
    const ConnectionId later{"you", scenes.connect()};
    REQUIRE(scenes.open("me/town", later));
    CHECK(used("you") == large);
    scenes.disconnect(later);
    CHECK(used("you") == small);
    // A scene that has become smaller may grow again, but not at the expense of those who hold it.
    const ConnectionId early{"early", scenes.connect()};
    REQUIRE(scenes.open("me/town", early));
    CHECK(used("early") == large);
    REQUIRE(scenes.publish("town", many_squares(0), {.replace = true}, store.a));
    CHECK(used("early") == small);
    REQUIRE(scenes.publish("town", many_squares(200), {.replace = true}, store.a));
    CHECK(used("early") == small);
    scenes.disconnect(early);
    const ConnectionId other{"other", scenes.connect()};
    REQUIRE(scenes.open("me/town", other));

    // Once the owner lets go of it, it is theirs who have agreed to it.
    REQUIRE(scenes.unload("town", store.a));
    CHECK(scenes.find("me/town", 0, store.stranger).error().code == Code::scene_unknown);
    CHECK(scenes.find("me/town", 0, other));
    CHECK(used("you") == 0);
    CHECK(used("other") == large);
    CHECK(used("me") == 0);
    CHECK(store.budget.held_by("other") >= large);
    CHECK(store.budget.held_by("me") == 0);
    CHECK(store.budget.held_by("you") == 0);
}

TEST_CASE("a temporary scene stays its owner's while a connection of his holds it") {
    Store store;
    SceneStore& scenes = store.scenes;
    REQUIRE(
        scenes.publish("t", many_squares(0), {.temporary = true, .share = {"public"}}, store.a));
    REQUIRE(scenes.open("me/t", store.stranger));
    REQUIRE(scenes.publish("t", many_squares(200), {.replace = true, .temporary = true}, store.a));
    CHECK(scenes.usage_of({"you"}).at("you").bytes == many_squares(0)->bytes().size());
    scenes.disconnect(store.a);
    CHECK(scenes.size() == 0);
    CHECK(store.budget.used() == 0);
}

TEST_CASE("an edit that adds is asked for its owner's quota of bytes") {
    Store store;
    SceneStore& scenes = store.scenes;
    store.limits.principal_scene_bytes_max = many_squares(20)->bytes().size();
    scenes.set_limits(store.limits);
    const auto before = scenes.publish("town", many_squares(0), {}, store.a);
    REQUIRE(before);
    const auto refused = scenes.publish_edit(*before, many_squares(200), store.a);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::quota);
    CHECK(scenes.find("town", 0, store.a)->epoch == before->epoch);
    CHECK(scenes.publish_edit(*before, many_squares(20), store.a).value());
    // An edit that takes no more is allowed whatever the quota has become.
    store.limits.principal_scene_bytes_max = 1;
    scenes.set_limits(store.limits);
    CHECK(scenes.publish_edit(*scenes.find("town", 0, store.a), many_squares(19), store.a).value());
}

TEST_CASE("a connection that reloads a name drops the unloaded scene") {
    Store store;
    SceneStore& scenes = store.scenes;
    REQUIRE(scenes.publish("town", square(1), {}, store.a));
    REQUIRE(scenes.open("town", store.b));
    REQUIRE(scenes.unload("town", store.a));
    REQUIRE(scenes.publish("town", square(3), {}, store.b));
    CHECK(size_of(scenes.find("town", 0, store.b)) == 3);
    CHECK(scenes.size() == 1);
}

TEST_CASE("a name keeps its scene when all connections are gone") {
    Store store;
    REQUIRE(store.scenes.publish("town", square(1), {}, store.a));
    store.scenes.disconnect(store.a);
    store.scenes.disconnect(store.a);
    CHECK(store.scenes.find("town", 0, store.b));
    CHECK(store.scenes.unload("town", store.b)->empty());
    CHECK(store.budget.used() == 0);
}

TEST_CASE("a temporary scene goes with its connections") {
    Store store;
    SceneStore& scenes = store.scenes;
    const Publication temporary{.temporary = true, .share = {"public"}};
    REQUIRE(scenes.publish("mesh", square(1), temporary, store.a));
    REQUIRE(scenes.publish("mesh", square(1), temporary, store.b));
    CHECK(scenes.find("mesh", 0, store.stranger));
    REQUIRE(scenes.unload("mesh", store.a));
    CHECK(scenes.find("mesh", 0, store.a));  // as long as b holds it
    scenes.disconnect(store.b);
    CHECK(scenes.find("mesh", 0, store.a).error().code == Code::scene_unknown);
    CHECK(store.budget.used() == 0);
}

TEST_CASE("unloading a temporary scene keeps what others hold by that name") {
    Store store;
    SceneStore& scenes = store.scenes;
    const Publication temporary{.temporary = true};
    REQUIRE(scenes.publish("mesh", square(1), {}, store.a));
    scenes.disconnect(store.a);
    REQUIRE(scenes.publish("mesh", square(1), temporary, store.b));
    CHECK(*scenes.unload("mesh", store.b) == Names{"me (by its name)"});
    CHECK(scenes.find("mesh", 0, store.b));
    // It was also loaded by its name, so it is unloaded by it.
    REQUIRE(scenes.publish("mesh", square(1), {}, store.b));
    REQUIRE(scenes.publish("mesh", square(1), temporary, store.b));
    CHECK(scenes.unload("mesh", store.b)->empty());
    CHECK_FALSE(scenes.find("mesh", 0, store.b));
}

TEST_CASE("another principal may open and close a shared scene, but not unload it") {
    Store store;
    SceneStore& scenes = store.scenes;
    REQUIRE(scenes.publish("town", square(1), store.shared, store.a));
    CHECK(scenes.unload("town", store.stranger).error().code == Code::not_allowed);
    REQUIRE(scenes.open("town", store.stranger));
    CHECK(*scenes.unload("town", store.stranger) == Names{"me (by its name)", "me (1 connection)"});
    CHECK(scenes.find("town", 0, store.stranger));
    // Another principal's opening does not keep the owner from replacing a scene.
    REQUIRE(scenes.open("town", store.stranger));
    REQUIRE(scenes.publish("town", square(2), {.replace = true}, store.b));
    CHECK(size_of(scenes.find("town", 0, store.stranger)) == 2);
}

TEST_CASE("jobs keep a scene that nobody else holds") {
    Store store;
    REQUIRE(store.scenes.publish("town", square(1), {}, store.a));
    auto job = store.scenes.find("town", 0, store.b);
    CHECK(store.scenes.unload("town", store.a)->empty());
    CHECK(store.budget.used() > 0);
    job = refuse(Code::cancelled, "");
    CHECK(store.budget.used() == 0);
}

TEST_CASE("scenes unused for long, or all scenes, are unloaded at once") {
    Store store;
    SceneStore& scenes = store.scenes;
    REQUIRE(scenes.publish("old", square(1), {}, store.a));
    REQUIRE(scenes.publish("used", square(2), {}, store.a));
    REQUIRE(scenes.publish("theirs", square(3), store.shared, store.stranger));
    store.now += std::chrono::minutes(50);
    REQUIRE(scenes.find("used", 0, store.b));
    REQUIRE(scenes.publish("new", square(4), {}, store.b));
    store.now += std::chrono::minutes(20);
    const auto listed = scenes.list(store.a);
    REQUIRE(listed.size() == 4);
    CHECK(listed[1].scene.name == "old");
    CHECK(listed[1].owner == "me");
    CHECK(listed[1].age == std::chrono::minutes(70));
    CHECK(listed[1].idle == std::chrono::minutes(70));
    CHECK(listed[3].idle == std::chrono::minutes(20));
    CHECK(listed[3].holders == 1);

    const auto unloaded = [&](SceneStore::Clock::duration idle, std::size_t most) {
        Names names;
        for (const auto& done : scenes.unload_idle(idle, most, store.b)) {
            names.push_back(done.name);
            // Connection a holds those that it loaded.
            CHECK(done.holders.empty() == (done.name == "new"));
        }
        return names;
    };
    const auto hour = std::chrono::hours(1);
    CHECK(unloaded(hour, 128) == Names{"old"});
    CHECK(unloaded(hour, 128).empty());
    CHECK(unloaded({}, 1) == Names{"new"});
    CHECK(unloaded({}, 128) == Names{"used"});
    const auto unlisted = scenes.unlisted();
    CHECK(unlisted.scenes == 2);
    CHECK(unlisted.bytes == square(1)->bytes().size() + square(2)->bytes().size());
    CHECK(store.names(store.b) == Names{"you/theirs"});
}

TEST_CASE("quotas count opened scenes too, and name the least recently used one") {
    Store store;
    protocol::Limits limits;
    limits.principal_scenes_max = 4;
    SceneStore scenes(store.budget, limits, [&] { return store.now; });
    for (const char* name : {"one", "two", "three", "four"}) {
        store.now += std::chrono::seconds(1);
        REQUIRE(scenes.publish(name, square(1), {}, store.a));
    }
    store.now += std::chrono::seconds(1);
    REQUIRE(scenes.find("one", 0, store.a));
    const auto full = scenes.publish("five", square(1), {}, store.a);
    REQUIRE_FALSE(full);
    CHECK(full.error().code == Code::quota);
    CHECK(full.error().message.find("least recently used: 'two', 'three', 'four'") !=
          std::string::npos);
    CHECK(full.error().message.find("raynest unload") != std::string::npos);
    REQUIRE(scenes.publish("theirs", square(2), store.shared, store.stranger));
    CHECK(scenes.open("theirs", store.a).error().code == Code::quota);
    CHECK(scenes.open("one", store.b));
}

TEST_CASE("the memory of a scene is charged to one of those who hold it") {
    Store store;
    SceneStore& scenes = store.scenes;
    const auto square_bytes = square(1)->bytes().size();
    REQUIRE(scenes.publish("town", square(1), store.shared, store.a));
    CHECK(store.budget.held_by("me") == square_bytes);
    REQUIRE(scenes.open("town", store.stranger));
    CHECK(store.budget.held_by("you") == 0);
    REQUIRE(scenes.unload("town", store.a));
    CHECK(store.budget.held_by("me") == 0);
    CHECK(store.budget.held_by("you") == square_bytes);
    // The same content is held once.
    REQUIRE(scenes.publish("village", square(1), {}, store.b));
    CHECK(store.budget.used() == square_bytes);
    scenes.disconnect(store.stranger);
    CHECK(store.budget.held_by("you") == 0);
    CHECK(store.budget.held_by("me") == square_bytes);
    REQUIRE(scenes.unload("village", store.b));
    CHECK(store.budget.used() == 0);
}

TEST_CASE("what a principal is told that it holds says nothing of others") {
    const auto bytes = square(1)->bytes().size();
    const auto larger = many_squares(20)->bytes().size();
    // Without anybody else, with one who came before, and with one who comes later.
    for (const int others : {0, 1, 2}) {
        CAPTURE(others);
        Store store;
        SceneStore& scenes = store.scenes;
        const auto other_loads = [&](const char* name, const auto& content) {
            REQUIRE(scenes.publish(name, content, store.shared, store.stranger));
        };
        const auto told = [&] { return scenes.memory_of("me"); };
        const auto request = store.budget.reserve(1000, "me");
        if (others == 1) other_loads("theirs", square(1));
        REQUIRE(scenes.publish("town", square(1), {}, store.a));
        CHECK(told() == 1000 + bytes);
        if (others == 2) other_loads("theirs", square(1));
        CHECK(told() == 1000 + bytes);
        // The epoch before an edit is its owner's as long as the next edit may use its memory.
        if (others == 1) other_loads("also theirs", many_squares(20));
        REQUIRE(scenes.publish_edit(*scenes.find("town", 0, store.a), many_squares(20), store.a)
                    .value());
        if (others == 2) other_loads("also theirs", many_squares(20));
        CHECK(told() == 1000 + bytes + larger);
        if (others != 0) REQUIRE(scenes.unload("theirs", store.stranger));
        CHECK(told() == 1000 + bytes + larger);
        scenes.drop_spares();
        CHECK(told() == 1000 + larger);
        // A request that goes on reads what was unloaded.
        std::optional<NamedScene> read(*scenes.find("town", 0, store.a));
        std::optional<NamedScene> theirs;
        if (others != 0) theirs = *scenes.find("also theirs", 0, store.stranger);
        REQUIRE(scenes.unload("town", store.a));
        if (others != 0) REQUIRE(scenes.unload("also theirs", store.stranger));
        CHECK(told() == 1000 + larger);
        CHECK(scenes.memory_of("you") == (others == 0 ? 0 : larger));
        theirs.reset();
        CHECK(told() == 1000 + larger);
        read.reset();
        CHECK(told() == 1000);
    }
}

TEST_CASE("a scene that only requests read any more is charged to one of those who ask") {
    Store store;
    SceneStore& scenes = store.scenes;
    const auto bytes = square(1)->bytes().size();
    REQUIRE(scenes.publish("town", square(1), store.shared, store.a));
    std::optional<NamedScene> mine(*scenes.find("town", 0, store.a));
    std::optional<NamedScene> theirs(*scenes.find("me/town", 0, store.stranger));
    std::optional<NamedScene> copy = theirs;  // as a plan goes from a request to its tasks
    REQUIRE(scenes.unload("town", store.a));
    // Its payer reads it still.
    CHECK(store.budget.held_by("me") == bytes);
    CHECK(mine->left_bytes("me") == bytes);
    CHECK(theirs->left_bytes("you") == 0);
    mine.reset();
    theirs.reset();
    REQUIRE(scenes.publish("village", square(2), store.shared, store.a));
    CHECK(store.budget.held_by("me") == bytes);
    CHECK(store.budget.held_by("you") == bytes);
    CHECK(copy->left_bytes("you") == bytes);
    // Once it has a name again, it is charged to who has given it that.
    REQUIRE(scenes.publish("town", square(1), {}, store.b));
    CHECK(store.budget.held_by("me") == 2 * bytes);
    CHECK(store.budget.held_by("you") == 0);
    CHECK(copy->left_bytes("you") == 0);
    // An epoch before an edit, or before a load in its place, is as one that was unloaded.
    REQUIRE(scenes.publish("town", square(3), {.replace = true}, store.a));
    CHECK(store.budget.held_by("me") == 2 * bytes);
    CHECK(store.budget.held_by("you") == bytes);
    copy.reset();
    CHECK(store.budget.held_by("you") == 0);
    // Who no longer reads is not charged.
    REQUIRE(scenes.find("me/village", 0, store.stranger));
    REQUIRE(scenes.unload("village", store.a));
    CHECK(store.budget.held_by("you") == 0);
}

TEST_CASE(
    "the memory of all scenes that a connection held is charged to those who still hold them") {
    Store store;
    SceneStore& scenes = store.scenes;
    const auto square_bytes = square(1)->bytes().size();
    for (const char* name : {"a", "b", "c"})
        REQUIRE(scenes.publish(name, square(1 + static_cast<float>(name[0])),
                               {.temporary = true, .share = {"public"}}, store.a));
    REQUIRE(scenes.open("a", store.stranger));
    REQUIRE(scenes.open("c", store.stranger));
    REQUIRE(scenes.publish("kept", square(1 + static_cast<float>('c')), {}, store.b));
    CHECK(store.budget.held_by("me") == 3 * square_bytes);
    scenes.disconnect(store.a);
    CHECK(store.budget.held_by("me") == square_bytes);
    CHECK(store.budget.held_by("you") == square_bytes);
    CHECK(scenes.unload_idle({}, 128, store.b).size() == 1);
    CHECK(store.budget.held_by("me") == 0);
    CHECK(store.budget.held_by("you") == 2 * square_bytes);
}

double processor_seconds() {
    timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

TEST_CASE("letting go of many scenes looks at all scenes as often as letting go of one") {
    constexpr int others = 2000;
    constexpr int many = 200;
    Budget budget(1 << 30);
    protocol::Limits limits;
    limits.principal_scenes_max = 2 * others;
    SceneStore scenes(budget, limits);
    const auto content = square(1);
    const ConnectionId stranger{"you", scenes.connect()};
    for (int i = 0; i < others; ++i)
        REQUIRE(scenes.publish("other " + std::to_string(i), content, {}, stranger));
    // Returns the time to let go of so many.
    const auto time_of = [&](int count, const auto& let_go) {
        const ConnectionId me{"me", scenes.connect()};
        std::vector<std::shared_ptr<const HeldScene>> used;  // their memory stays
        for (int i = 0; i < count; ++i) {
            const auto scene = scenes.publish(std::to_string(i), square(2 + static_cast<float>(i)),
                                              {.temporary = true}, me);
            REQUIRE(scene);
            used.push_back(scene->held);
        }
        const double began = processor_seconds();
        let_go(me);
        const double seconds = processor_seconds() - began;
        CHECK(scenes.size() == others);
        return seconds;
    };
    const auto disconnect = [&](const ConnectionId& me) { scenes.disconnect(me); };
    const auto unload = [&](const ConnectionId& me) {
        CHECK(scenes.unload_idle({}, many, me).size() != 0);
    };
    CHECK(time_of(many, disconnect) < 20 * time_of(1, disconnect));
    CHECK(time_of(many, unload) < 20 * time_of(1, unload));
}

TEST_CASE("owners of one content are settled in a time that grows with their number alone") {
    const auto time_of = [content = square(1)](int owners) {
        Store store;
        const double began = processor_seconds();
        for (int i = 0; i < owners; ++i)
            REQUIRE(store.scenes.publish("s", content, {},
                                         {std::to_string(i), static_cast<std::uint64_t>(i) + 9}));
        return processor_seconds() - began;
    };
    CHECK(time_of(400) < 30 * time_of(100));
}

}  // namespace
}  // namespace raynest::server

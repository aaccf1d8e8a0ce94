// Which stored scenes leave the memory, in which order, and what principals have of them.
#include "server/store/scene_store.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <chrono>
#include <memory>
#include <set>
#include <string>

namespace raynest::server {
namespace {

using test::square;
using Names = std::set<std::string>;

struct Store {
    /// Memory and quota are so many squares.
    explicit Store(std::uint64_t memory = 1000, std::uint64_t quota = 1000)
        : budget(memory * bytes) {
        limits.principal_scene_bytes_max = quota * bytes;
        scenes.set_limits(limits);
    }

    /// Stores a scene, later than all before.
    void put(const std::string& name, float size, const ConnectionId& caller) {
        now += std::chrono::seconds(1);
        const auto scene = square(size);
        Publication how;
        how.blob = std::make_shared<const std::string>(scene->arena_id());
        how.row = {.number = ++rows,
                   .owner = caller.principal,
                   .name = name,
                   .digest = scene->arena_id(),
                   .epoch = 1,
                   .bytes = scene->bytes().size()};
        REQUIRE(scenes.publish(name, scene, how, caller));
    }
    Reply<NamedScene> use(const std::string& name, const ConnectionId& caller) {
        now += std::chrono::seconds(1);
        return scenes.find(name, 0, caller);
    }
    [[nodiscard]] Names in_memory() const {
        Names names;
        for (const auto& listed : scenes.list({"root", 9, Role::admin}))
            if (const std::string& name = listed.scene.name; listed.scene.held)
                names.insert(name.substr(name.rfind('/') + 1));
        return names;
    }

    const std::uint64_t bytes = square(1)->bytes().size();
    Budget budget;
    protocol::Limits limits;
    // Stored scenes may have been used before the clock began.
    SceneStore::Clock::time_point now{-std::chrono::hours(1000)};
    SceneStore scenes{budget, limits, [this] { return now; }};
    std::uint64_t rows = 0;
    const ConnectionId me{"me", scenes.connect()};
    const ConnectionId you{"you", scenes.connect()};
};

TEST_CASE("of a principal beyond its quota, what it has not used for longest leaves the memory") {
    Store store(1000, 5);
    // Not in the order of their names
    float size = 0;
    for (const char* name : {"e", "d", "a", "b", "c"}) store.put(name, ++size, store.me);
    store.put("yours", 6, store.you);
    auto in_use = store.use("e", store.me);
    REQUIRE(in_use);
    REQUIRE(store.scenes.pin("d", true, store.me));
    REQUIRE(store.use("a", store.me));  // now b, c, and then a

    store.scenes.make_room(0, "me");
    CHECK(store.in_memory().size() == 6);
    store.scenes.make_room(1, "me");
    CHECK(store.in_memory() == Names{"a", "c", "d", "e", "yours"});
    store.scenes.make_room(2 * store.bytes, "me");
    CHECK(store.in_memory() == Names{"a", "d", "e", "yours"});
    // Nothing helps against what is too much by itself.
    store.scenes.make_room(6 * store.bytes, "me");
    CHECK(store.in_memory().size() == 4);
    store.scenes.make_room(5 * store.bytes, "me");
    CHECK(store.in_memory() == Names{"d", "e", "yours"});
    in_use = refuse(Code::cancelled, "");
    store.scenes.make_room(5 * store.bytes, "me");
    CHECK(store.in_memory() == Names{"d", "yours"});
    CHECK(store.scenes.asleep_of("me") == 4);
    CHECK(store.scenes.asleep_of("you") == 0);
}

TEST_CASE("beyond the memory, own scenes leave first, then those of who holds more, or none") {
    Store store(20);
    store.put("c", 1, store.you);
    store.put("b", 2, store.me);
    store.put("a", 3, store.you);
    const auto room = [&] { return store.budget.room("me", Use::lasting); };
    const auto has = [&](const Names& names) { return store.in_memory() == names; };
    store.scenes.make_room(room(), "me");
    CHECK(has({"a", "b", "c"}));
    // Nothing goes for what is too much even without all of them.
    const std::uint64_t most = store.scenes.most_room("me");
    CHECK(most > room());
    for (const std::uint64_t too_much : {most + 1, store.budget.limit(), ~std::uint64_t{0}})
        store.scenes.make_room(too_much, "me");
    CHECK(has({"a", "b", "c"}));
    store.scenes.make_room(room() + 1, "me");
    CHECK(has({"a", "c"}));
    {
        const auto mine = store.budget.reserve(2 * store.bytes, "me", Use::lasting);
        CHECK(store.scenes.most_room("me") == room());
        store.scenes.make_room(room() + 1, "me");
        store.scenes.make_all_room("me");
        CHECK(has({"a", "c"}));
    }
    const auto mine = store.budget.reserve(store.bytes, "me", Use::lasting);
    store.scenes.make_room(room() + 1, "me");
    CHECK(has({"a"}));
    store.scenes.make_all_room("me");
    CHECK(has({"a"}));
    store.scenes.make_room(store.scenes.most_room("you"), "you");
    CHECK(has({}));
    CHECK(store.budget.used() == store.bytes);
}

TEST_CASE("requests of others do not keep a scene in memory at its owner's expense") {
    Store store(1000, 2);
    store.put("a", 1, store.me);
    store.put("b", 2, store.me);
    const auto theirs = store.scenes.find("a", 0, {"other", store.scenes.connect(), Role::admin});
    REQUIRE(theirs);
    store.scenes.make_room(store.bytes, "me");
    CHECK(store.in_memory() == Names{"b"});
    CHECK(store.budget.held_by("me") == store.bytes);
    CHECK(store.budget.held_by("other") == store.bytes);
    // One's own requests do.
    auto mine = store.use("b", store.me);
    REQUIRE(mine);
    const auto more = store.scenes.find("b", 0, {"other", store.scenes.connect(), Role::admin});
    REQUIRE(more);
    store.scenes.make_room(2 * store.bytes, "me");
    CHECK(store.in_memory() == Names{"b"});
    mine = refuse(Code::cancelled, "");
    // Nor do those of a principal whose share is full.
    const std::uint64_t room = store.budget.room("other", Use::lasting);
    const auto full = store.budget.reserve(room, "other", Use::lasting);
    REQUIRE(full);
    store.scenes.make_room(2 * store.bytes, "me");
    CHECK(store.in_memory().empty());
    CHECK(store.budget.held_by("me") == 0);
    CHECK(store.budget.held_by("other") == room + 2 * store.bytes);
}

TEST_CASE("one content leaves the memory with all of its names, or stays") {
    Store store(1000, 4);
    store.put("a", 1, store.me);
    store.put("b", 2, store.me);
    store.put("c", 1, store.me);  // a is as new as this
    store.scenes.make_room(2 * store.bytes, "me");
    CHECK(store.in_memory() == Names{"a", "c"});
    // A name without a blob needs the memory.
    REQUIRE(store.scenes.publish("d", square(1), {.temporary = true}, store.you));
    store.scenes.make_room(4 * store.bytes, "me");
    CHECK(store.in_memory() == Names{"a", "c", "d"});
    REQUIRE(store.scenes.unload("d", store.you));
    store.scenes.make_room(4 * store.bytes, "me");
    CHECK(store.in_memory().empty());
}

TEST_CASE("a principal is charged with its names and what it holds, and with each blob once") {
    Store store;
    store.put("a", 1, store.me);
    store.put("b", 1, store.me);
    store.put("c", 2, store.me);
    REQUIRE(store.scenes.publish("public", square(3), {.share = {"public"}}, store.you));
    REQUIRE(store.scenes.open("you/public", store.me));
    REQUIRE(store.scenes.publish("short", square(4), {.temporary = true}, store.you));
    const auto all = store.scenes.usage_of({"me", "you", "nobody", "me"});
    REQUIRE(all.size() == 3);
    CHECK(all.at("me").scenes == 4);
    CHECK(all.at("me").bytes == 4 * store.bytes);
    CHECK(all.at("me").disk_bytes == 2 * store.bytes);
    CHECK(all.at("you").scenes == 2);
    CHECK(all.at("you").bytes == 2 * store.bytes);
    CHECK(all.at("you").disk_bytes == 0);
    CHECK(all.at("nobody").scenes == 0);
    for (const auto& [principal, usage] : all) {
        const auto listed = store.scenes.charged_to(principal, true);
        const auto unlisted = store.scenes.charged_to(principal, false);
        CHECK(usage.scenes == listed.scenes + unlisted.scenes);
        CHECK(usage.bytes == listed.bytes + unlisted.bytes);
    }
}

TEST_CASE("several scenes are found as each of them would be") {
    Store store;
    store.put("a", 1, store.me);
    for (const ConnectionId& owner : {store.you, ConnectionId{"them", 7}})
        REQUIRE(store.scenes.publish("b", square(2), {.share = {"public"}}, owner));
    REQUIRE(store.scenes.publish("hidden", square(3), {}, store.you));
    const auto found = store.scenes.find_each({"you/b", "a", "me/a", "a", "them/b"}, store.me);
    REQUIRE(found);
    REQUIRE(found->size() == 5);
    CHECK((*found)[0].name == "you/b");
    CHECK((*found)[1].name == "a");
    CHECK((*found)[2].name == "a");
    CHECK((*found)[3].held == (*found)[1].held);
    CHECK((*found)[4].name == "them/b");
    CHECK(store.scenes.find_each({}, store.me)->empty());
    for (const char* name : {"b", "hidden", "you/hidden", "none"}) {
        const auto alone = store.scenes.find(name, 0, store.me);
        const auto among = store.scenes.find_each({"a", name, "none"}, store.me);
        REQUIRE_FALSE(among);
        CHECK(among.error().code == alone.error().code);
        CHECK(among.error().message == alone.error().message);
    }
}

}  // namespace
}  // namespace raynest::server

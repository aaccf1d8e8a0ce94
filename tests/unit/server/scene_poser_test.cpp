// Scenes at other times: how many are made at once, and who waits for them.
#include "server/jobs/scene_poser.h"

#include "engine/scene/motion/velocities.h"
#include "server/ground/waiters.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <functional>
#include <list>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using Seconds = std::vector<double>;

SceneDescription moving_scene() {
    MotionTables motion;
    motion.floats = {0, 1, 0, 0, 0, 0, 3, 0};
    motion.samplers = {{0, 2, 2, 3, Interpolation::linear}};
    motion.nodes.resize(1);
    motion.nodes[0].has_trs = 1;
    motion.instances.push_back({0, 0});
    motion.channels = {{0, 0, MotionPath::translation}};
    motion.animations.push_back({0, 0, 1, 1});
    motion.names = {'m', '\0'};
    SceneDescription scene = test::tree_scene();
    scene.motion = motion_bytes(motion);
    return scene;
}

/// Asks as requests do: again, whenever it is told to.
class Asking {
public:
    using Request = std::shared_ptr<ScenePoser::Ready>;

    [[nodiscard]] Request ask(double seconds, const std::string& principal = "me") {
        auto again = std::make_shared<ScenePoser::Ready>();
        *again = [this, seconds, principal, self = std::weak_ptr(again)](const Reply<void>& ready) {
            if (ready) look(seconds, principal, self);
        };
        look(seconds, principal, again);
        return again;
    }
    /// Runs all tasks and returns how many there were. Nobody hears of their ends yet.
    std::size_t run_tasks() {
        std::size_t count = 0;
        while (daemon.blocking.run_one()) ++count;
        return count;
    }
    /// The io thread hears of the next task's end, and has all turns that this takes.
    void end_one() {
        const auto done = std::move(daemon.posted.front());
        daemon.posted.pop_front();
        const std::size_t others = daemon.posted.size();
        done();
        while (daemon.posted.size() > others) {
            const auto turn = std::move(daemon.posted.back());
            daemon.posted.pop_back();
            turn();
        }
    }

    test::SmallDaemon daemon;
    ScenePoser poser{daemon.services,
                     [this](std::function<void()> done) { daemon.posted.push_back(done); }};
    const NamedScene scene = daemon.scenes
                                 .publish("moving", test::build_scene(moving_scene()), {},
                                          {"me", daemon.scenes.connect()})
                                 .value();
    Seconds found;

private:
    void look(double seconds, const std::string& principal,
              const std::weak_ptr<ScenePoser::Ready>& self) {
        Caller caller;
        caller.principal = principal;
        if (poser.find(scene, "", seconds, caller)) {
            found.push_back(seconds);
            return;
        }
        const auto wanted = poser.take_wanted();
        REQUIRE(wanted);
        poser.make(*wanted, principal, self);
    }
};

TEST_CASE("a principal has few poses under way; others wait for these, and are made then") {
    Asking asking;
    std::vector<Asking::Request> requests;
    Seconds all;
    for (int i = 0; i < 10; ++i) {
        all.push_back(0.0625 * i);
        for (int twice = 0; twice < 2; ++twice) requests.push_back(asking.ask(all.back()));
    }
    CHECK(asking.run_tasks() == ScenePoser::kept_max);
    // Another principal does not wait for them.
    requests.push_back(asking.ask(1, "you"));
    CHECK(asking.run_tasks() == 1);
    CHECK(asking.daemon.posted.size() == 5);

    const Snapshot& scene = asking.scene.snapshot();
    const std::uint64_t each =
        scene.bytes().size() + Velocities::bytes_for(checked_motion(scene.motion_bytes()));
    std::size_t made = 5;
    while (!asking.daemon.posted.empty()) {
        asking.end_one();
        const std::size_t begun = asking.run_tasks();
        CHECK(begun <= 1);
        made += begun;
        CHECK(asking.daemon.posted.size() <= ScenePoser::kept_max + 1);
        CHECK(asking.poser.held_by("me") <= ScenePoser::kept_max * each);
    }
    CHECK(made == all.size() + 1);
    Seconds wanted;
    for (const double seconds : all) {
        wanted.insert(wanted.end(), 2, seconds);
        if (wanted.size() == 2 * ScenePoser::kept_max) wanted.push_back(1);
    }
    CHECK(asking.found == wanted);
}

TEST_CASE("requests of two moments each get both, however many there are") {
    Asking asking;
    struct Pair {
        double first = 0;
        std::vector<std::shared_ptr<const HeldScene>> held = {};
        Asking::Request again = std::make_shared<ScenePoser::Ready>();
        bool has_both = false;
    };
    std::list<Pair> pairs;
    Caller caller;
    caller.principal = "me";
    const auto look = [&](Pair& pair) {
        (void)asking.poser.take_wanted();
        pair.has_both = asking.poser.find(asking.scene, "", pair.first, caller) &&
                        asking.poser.find(asking.scene, "", pair.first + 0.01, caller);
        const auto wanted = asking.poser.take_wanted();
        pair.held = wanted ? wanted->found : decltype(pair.held){};
        if (wanted) asking.poser.make(*wanted, "me", pair.again);
    };
    for (int i = 0; i < 10; ++i) {
        Pair& pair = pairs.emplace_back(Pair{0.09 * i});
        *pair.again = [&](const Reply<void>&) { look(pair); };
    }
    for (Pair& pair : pairs) look(pair);
    std::size_t made = 0;
    for (std::size_t turn = 0; turn < 100; ++turn) {
        made += asking.run_tasks();
        if (asking.daemon.posted.empty()) break;
        asking.end_one();
    }
    CHECK(made == 2 * pairs.size());
    for (const Pair& pair : pairs) CHECK(pair.has_both);
}

TEST_CASE("a request that was cancelled while it waited is not made, and holds up nobody") {
    Asking asking;
    std::vector<Asking::Request> requests;
    for (const double seconds : {0.1, 0.2, 0.3, 0.4}) requests.push_back(asking.ask(seconds));
    for (int i = 0; i < 1000; ++i) static_cast<void>(asking.ask(0.5 + 0.0001 * i));
    requests.push_back(asking.ask(0.9));
    CHECK(asking.run_tasks() == ScenePoser::kept_max);
    asking.end_one();
    CHECK(asking.run_tasks() == 1);
    while (!asking.daemon.posted.empty()) asking.end_one();
    CHECK(asking.run_tasks() == 0);
    CHECK(asking.found == Seconds{0.1, 0.2, 0.3, 0.4, 0.9});
}

TEST_CASE("what nobody has used for a while is freed, and not before") {
    Asking asking;
    const auto request = asking.ask(0.5);
    asking.run_tasks();
    asking.end_one();
    REQUIRE(asking.found.size() == 1);
    (void)asking.poser.take_wanted();  // which holds what was found
    const auto begun = ScenePoser::Clock::now();
    const std::uint64_t held = asking.poser.held_by("me");
    CHECK(held != 0);
    asking.poser.drop_idle(begun + ScenePoser::kept_time - std::chrono::seconds(1));
    CHECK(asking.poser.held_by("me") == held);
    asking.poser.drop_idle(begun + ScenePoser::kept_time + std::chrono::milliseconds(1));
    CHECK(asking.poser.held_by("me") == 0);
    CHECK(asking.daemon.budget.held_by("me") == asking.scene.snapshot().bytes().size());
}

TEST_CASE("what is to be made has memory for the scene twice, or nothing is begun") {
    Asking asking;
    Budget& budget = asking.daemon.budget;
    const std::uint64_t scene = asking.scene.snapshot().bytes().size();
    for (const std::uint64_t halves : {3U, 5U}) {
        CAPTURE(halves);
        // Four fifths of what is free are room.
        const std::uint64_t free = 5 * halves * scene / 8;
        const auto rest = budget.reserve(budget.limit() - budget.used() - free);
        const auto request = asking.ask(0.5);
        CHECK(asking.run_tasks() == (halves < 4 ? 0 : 1));
    }
}

TEST_CASE("those who have gone take no room among those who wait") {
    Waiters waiters;
    std::vector<std::shared_ptr<Waiters::Awake>> stay;
    std::vector<int> woken;
    for (int i = 0; i < 100; ++i) {
        stay.push_back(std::make_shared<Waiters::Awake>(
            [&woken, i](const Reply<void>&) { woken.push_back(i); }));
        waiters.add(stay.back());
        for (int gone = 0; gone < 100; ++gone)
            waiters.add(std::make_shared<Waiters::Awake>([](const Reply<void>&) {}));
    }
    CHECK(waiters.size() <= 2 * stay.size() + 1);
    CHECK_FALSE(waiters.all_expired());
    waiters.wake_first({});
    waiters.wake_first({});
    CHECK(woken == std::vector{0, 1});
    waiters.wake_all({}, [](const std::function<void()>& next) { next(); });
    CHECK(woken.size() == 100);
    CHECK(woken.back() == 99);
    CHECK(waiters.empty());
    waiters.wake_first({});
    stay.clear();
    CHECK(waiters.all_expired());
}

}  // namespace
}  // namespace raynest::server

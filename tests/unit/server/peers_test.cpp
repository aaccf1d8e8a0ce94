// Tests which peers give way to a newcomer, on a clock that the test moves.
#include "server/scheduling/peers.h"

#include <doctest/doctest.h>

#include <memory>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

/// Peers whose names tell which one gave way.
class House {
public:
    class Guest final : public Peer {
    public:
        Guest(House& house, std::string name, std::string principal)
            : house_(house),
              name_(std::move(name)),
              principal_(std::move(principal)),
              moved(house.now) {
            house_.peers.join(*this);
        }
        ~Guest() { house_.peers.leave(*this); }
        [[nodiscard]] const std::string& principal() const override { return principal_; }
        [[nodiscard]] std::uint64_t holds(Resource resource) const override {
            return resource == Resource::memory ? bytes : 1;
        }
        [[nodiscard]] std::optional<Clock::time_point> paused_since() const override {
            return works ? std::nullopt : std::optional(moved);
        }
        void give_way(const protocol::Error& why) override {
            house_.gone.push_back(name_);
            house_.why = why;
            house_.peers.leave(*this);
            lease = {};
        }

    private:
        House& house_;
        const std::string name_;
        const std::string principal_;

    public:
        Clock::time_point moved;
        std::uint64_t bytes = 0;
        Budget::Lease lease;  ///< for `bytes`, if there is room
        bool works = false;   ///< is the daemon working for this peer?
    };

    Guest& guest(const std::string& name, const std::string& principal, std::uint64_t bytes = 0) {
        guests_.push_back(std::make_unique<Guest>(*this, name, principal));
        guests_.back()->bytes = bytes;
        if (auto lease = budget.reserve(bytes)) guests_.back()->lease = std::move(*lease);
        now += milliseconds(1);  // in order of arrival
        return *guests_.back();
    }
    using Names = std::vector<std::string>;

    protocol::Limits limits;
    Budget budget{1000};
    Metrics metrics;
    Clock::time_point now = Clock::time_point() + std::chrono::hours(1);
    Peers peers{limits, budget, metrics, [this] { return now; }};
    Names gone;
    protocol::Error why;

private:
    std::vector<std::unique_ptr<Guest>> guests_;
};

TEST_CASE(
    "the principal that holds most gives way, and of its peers the one that moved longest ago") {
    House house;
    house.guest("single", "a");
    house.guest("first", "b");
    House::Guest& second = house.guest("second", "b");
    house.guest("third", "b").works = true;
    house.now += seconds(60);
    CHECK(house.peers.make_room(Resource::connections, "c"));
    second.moved = house.now - seconds(70);
    CHECK(house.peers.make_room(Resource::connections, "c"));
    // The daemon works for b's last peer, so another principal's peer gives way.
    CHECK(house.peers.make_room(Resource::connections, "c"));
    CHECK_FALSE(house.peers.make_room(Resource::connections, "c"));
    CHECK(house.gone == House::Names{"first", "second", "single"});
    CHECK(house.peers.size() == 1);
    CHECK(house.metrics.gave_way_connections == 3);
    CHECK(house.why.code == Code::slow_consumer);
    CHECK(house.why.message.find("60 s") != std::string::npos);
    CHECK(house.why.message.find("no free connections") != std::string::npos);
    // Each of them has a request.
    CHECK(house.why.message.find("connect again, and read answers") != std::string::npos);
}

TEST_CASE("what paused peers hold of the memory is known before anybody gives way") {
    House house;
    house.guest("paused", "a", 300);
    house.guest("busy", "a", 200).works = true;
    house.now += seconds(60);
    CHECK(house.peers.reclaimable_bytes("b") == 300);
    CHECK(house.gone.empty());
    house.guest("large", "b", 600).works = true;
    CHECK(house.peers.reclaimable_bytes("b") == 0);
}

TEST_CASE("a peer that moved a frame a moment ago stays, one that moves single bytes does not") {
    House house;
    House::Guest& reader = house.guest("reader", "a");
    house.now += milliseconds(house.limits.give_way_ms - 2);
    CHECK_FALSE(house.peers.make_room(Resource::jobs, "a"));
    house.now += milliseconds(2);
    reader.moved = house.now;  // a whole frame
    house.now += milliseconds(house.limits.give_way_ms);
    CHECK(house.peers.make_room(Resource::jobs, "a"));
    CHECK(house.metrics.gave_way_jobs == 1);
}

TEST_CASE("no principal gives way to one that holds more") {
    House house;
    for (const char* name : {"one", "two", "three"}) house.guest(name, "crowd").works = true;
    house.guest("reader", "single");
    house.now += seconds(60);
    CHECK_FALSE(house.peers.make_room(Resource::connections, "crowd"));
    CHECK(house.gone.empty());
    CHECK(house.peers.make_room(Resource::connections, "single"));
    CHECK(house.gone == House::Names{"reader"});
}

TEST_CASE("at a principal's limit, only its own peers give way") {
    House house;
    house.guest("other", "b");
    house.guest("mine", "a");
    house.now += seconds(60);
    using Whose = Peers::Whose;
    CHECK(house.peers.make_room(Resource::connections, "a", 1, Whose::own));
    CHECK_FALSE(house.peers.make_room(Resource::connections, "a", 1, Whose::own));
    CHECK(house.gone == House::Names{"mine"});
    CHECK(house.peers.size_of("a") == 0);
    CHECK(house.peers.size_of("b") == 1);
}

TEST_CASE("memory comes from as many peers as needed, and from none if all are not enough") {
    House house;
    const auto scenes = house.budget.reserve(900);
    house.guest("idle", "a");
    house.guest("small", "a", 10);
    house.guest("large", "b", 30);
    house.guest("later", "b", 20);
    house.now += seconds(60);
    house.peers.make_memory(32, "c");  // four fifths of what is free
    house.peers.make_memory(81, "c");  // more than that of all they hold besides
    CHECK(house.gone.empty());
    house.peers.make_memory(70, "c");
    CHECK(house.gone == House::Names{"large", "later"});
    CHECK(house.metrics.gave_way_memory == 2);
}

TEST_CASE("scenes and answers weigh as much as what a principal's connections hold") {
    House house;
    const auto scenes = house.budget.reserve(500, "loader", Use::lasting);
    house.guest("reader", "single", 100);
    house.now += seconds(60);
    // The loader holds more than the reader, who stays.
    CHECK_FALSE(house.peers.make_room(Resource::memory, "loader"));
    CHECK(house.peers.make_room(Resource::memory, "another"));
}

TEST_CASE("a daemon that ends needs all places") {
    House house;
    house.guest("reader", "a");
    house.guest("busy", "a").works = true;
    house.peers.dismiss();
    CHECK(house.gone.empty());
    house.now += seconds(60);
    house.guest("new", "b");
    house.peers.dismiss();
    CHECK(house.gone == House::Names{"reader"});
    CHECK(house.why.code == Code::draining);
}

TEST_CASE("a peer that moved and never took its new name leaves as a whole") {
    House house;
    House::Guest& guest = house.guest("a", "address");
    house.peers.move(guest, "alice");
    CHECK(house.peers.size_of("alice") == 1);
    CHECK(house.peers.size_of("address") == 0);
    house.peers.leave(guest);
    house.peers.leave(guest);
    CHECK(house.peers.size_of("alice") == 0);
    CHECK(house.peers.size() == 0);
}

}  // namespace
}  // namespace raynest::server

// Tests that the io thread's work does not grow with a request or a scene: what it allocates,
// frees, touches and reads in one turn is the same for the smallest and for a large one.
#include "engine/scene/motion/motion.h"
#include "protocol/edit_row.h"
#include "server/execution/kept_selections.h"
#include "server/http/websocket_messages.h"
#include "server/jobs/scene_poser.h"
#include "server/scheduling/disposal.h"
#include "tests/sanitized.h"
#include "tests/unit/server/counted_memory.h"
#include "tests/unit/server/guarded_scene.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>
#include <malloc.h>
#include <sys/resource.h>

#include <algorithm>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::test {
namespace {

/// The work of a turn of the io thread.
struct Work {
    std::uint64_t allocated_bytes = 0;
    std::uint64_t kept_bytes = 0;  ///< by which the program's memory grew, or shrank
    std::uint64_t faults = 0;      ///< pages that were touched for the first time
    std::uint64_t scene_pages = 0;

    void raise_to(const Work& other) {
        allocated_bytes = std::max(allocated_bytes, other.allocated_bytes);
        kept_bytes = std::max(kept_bytes, other.kept_bytes);
        faults = std::max(faults, other.faults);
        scene_pages = std::max(scene_pages, other.scene_pages);
    }
};

/// What a turn may do: it handles a message of control_bytes_max, or a frame of rays.
constexpr std::uint64_t turn_bytes_max = 1 << 20;
constexpr std::uint64_t turn_faults_max = turn_bytes_max / 4096;
/// Pages of a scene: records of its root, a camera, names, and each step of a search by halves.
constexpr std::uint64_t turn_scene_pages_max = 64;

/// Bytes that the program has from malloc().
std::uint64_t heap_bytes() {
    const struct mallinfo2 now = mallinfo2();
    return now.uordblks + now.hblkhd;
}

/// Bytes that it has mapped, scenes included.
std::uint64_t mapped_bytes() {
    std::uint64_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    return pages * 4096;
}

std::uint64_t difference(std::uint64_t a, std::uint64_t b) {
    return a < b ? b - a : a - b;
}

std::uint64_t faults() {
    struct rusage used {};
    getrusage(RUSAGE_THREAD, &used);
    return static_cast<std::uint64_t>(used.ru_minflt);
}

/// Many animations, the last of which moves one instance, and many vertices that might move.
std::vector<std::byte> large_motion() {
    MotionTables motion;
    motion.floats = {0, 1, 0, 0, 0, 0, 3, 0};
    motion.samplers = {{0, 2, 2, 3, Interpolation::linear}};
    motion.nodes.resize(1);
    motion.nodes[0].has_trs = 1;
    motion.instances.push_back({7, 0});
    motion.channels = {{0, 0, MotionPath::translation}};
    motion.parts.resize(100'000);
    for (std::uint32_t i = 0; i < motion_animations_max; ++i) {
        const std::string name = std::to_string(i) + "th";
        motion.animations.push_back({static_cast<std::uint32_t>(motion.names.size()), 0, 1, 1});
        motion.names.insert(motion.names.end(), name.c_str(), name.c_str() + name.size() + 1);
    }
    return motion_bytes(motion);
}

/// Many objects, instances, materials and animations.
SceneDescription large_scene() {
    constexpr std::uint32_t objects = 20'000;
    SceneDescription scene;
    scene.objects.resize(objects + 1);
    scene.materials.resize(objects);
    for (std::uint32_t i = 0; i < objects; ++i) {
        scene.objects[i].name = "object " + std::to_string(i);
        scene.objects[i].geometries = {unit_square(i)};
    }
    ObjectDescription& root = scene.objects.back();
    root.name = "root";
    for (std::uint32_t i = 0; i < 3 * objects; ++i)
        root.instances.push_back(place(
            i % objects,
            translation(2.0F * static_cast<float>(i % 245), 2.0F * static_cast<float>(i / 245), 0),
            "instance " + std::to_string(i)));
    scene.root = objects;
    scene.motion = large_motion();
    return scene;
}

/// Rows of an Edit: each moves everything.
protocol::Frame edit_rows(std::uint64_t id, std::uint32_t count) {
    const std::vector<protocol::EditRow> rows(count, {protocol::EditRow::move,
                                                      0,
                                                      1,
                                                      protocol::EditRow::world,
                                                      {1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0}});
    const auto bytes = std::as_bytes(std::span(rows));
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, bytes.size());
    bulk.allocate();
    std::copy(bytes.begin(), bytes.end(), bulk.block(0).data());
    return protocol::encode(id, wire::UploadT{}, std::move(bulk)).value();
}

/// A daemon and a client; what the io side does is measured, what tasks do is not.
class Turns {
public:
    Turns(SmallDaemon& daemon, std::span<const std::byte> arena)
        : daemon_(daemon),
          scene_(arena),
          client_(daemon, "me") {
        turn([&] { client_.receive(protocol::encode(0, wire::HelloT{}).value()); });
        most = {};
    }

    template <class Native>
    void ask(const Native& message) {
        send(protocol::encode(++id, message).value());
    }
    void send(protocol::Frame frame) {
        asked.insert(frame.header.type);
        turn([&] { client_.receive(std::move(frame)); });
    }
    /// Takes completions and runs tasks, at most so many; false if none is left.
    bool run(std::size_t steps = ~std::size_t{0}) {
        for (; steps != 0; --steps) {
            bool stepped = true;
            if (daemon_.posted.empty())
                stepped = daemon_.step();
            else
                turn([&] { daemon_.step(); });
            // As a session does after each task and each write.
            turn([&] { client_.runner().pump(); });
            if (!stepped && daemon_.posted.empty()) return false;
        }
        return true;
    }
    /// Asks for the progress of a running job, as its client and every list of jobs do.
    void tick() {
        turn([&] { client_.runner().tick(server::Clock::now() + std::chrono::seconds(1)); });
    }

    template <class Function>
    void turn(Function&& function) {
        Work work;
        const std::uint64_t heap_before = heap_bytes(), mapped_before = mapped_bytes();
        const std::uint64_t allocated_before = allocated_bytes;
        const std::uint64_t faults_before = faults();
        work.scene_pages = scene_.count(function);
        // Giving a page of the scene back is a fault, too.
        const std::uint64_t faulted = faults() - faults_before;
        work.faults = faulted - std::min(faulted, 2 * work.scene_pages);
        work.allocated_bytes = allocated_bytes - allocated_before;
        work.kept_bytes = std::max(difference(heap_bytes(), heap_before),
                                   difference(mapped_bytes(), mapped_before));
        most.raise_to(work);
    }

    Work most;  ///< the most of all turns so far
    static inline std::set<std::uint16_t> asked;
    std::uint64_t id = 0;

private:
    SmallDaemon& daemon_;
    GuardedScene scene_;
    Client client_;
};

std::unique_ptr<wire::JobT> job(bool hides = false) {
    auto made = std::make_unique<wire::JobT>();
    made->scene = "large";
    if (hides) made->hidden_instances = {7};
    return made;
}

template <class Picture>
Picture picture(std::uint32_t side, const char* encode, bool hides = false) {
    Picture made;
    made.job = job(hides);
    made.width = made.height = side;
    if constexpr (requires { made.encode; }) made.encode = encode;
    return made;
}

wire::RenderT film(std::uint32_t side, const char* encode) {
    auto made = picture<wire::RenderT>(side, encode);
    made.integrator = "ao";
    made.samples = 1;
    return made;
}

wire::QueryT query(const char* reduce, bool hides = false) {
    wire::QueryT made;
    made.job = job(hides);
    made.reduce = reduce;
    made.generator = std::make_unique<wire::GeneratorT>();
    made.generator->kind = "camera";
    made.generator->settings = {"size=512x512"};
    return made;
}

template <class Native>
Native about_scene(Native made = {}) {
    made.scene = "large";
    return made;
}

TEST_CASE("no turn of the io thread does more for a large request and a large scene") {
    // AddressSanitizer has memory and handlers of its own.
    if (sanitized) return;
    SmallDaemon daemon({}, 4ULL << 30);
    const auto scene = build_scene(large_scene());
    const auto small = square(1);
    daemon.scenes.set_disposal([&](std::shared_ptr<const void> freed) {
        server::dispose(daemon.compute, "", std::move(freed));
    });
    REQUIRE(daemon.scenes.publish("large", scene, {}, {"me", daemon.scenes.connect()}));

    server::ScenePoser poser(daemon.services, [&](std::function<void()> done) {
        daemon.posted.push_back(std::move(done));
    });
    daemon.services.poser = &poser;
    server::KeptSelections selections(daemon.services.blocking);
    daemon.services.selections = &selections;
    const auto check = [&](const char* name, const auto& script) {
        Turns turns(daemon, scene->bytes());
        script(turns);
        turns.run();
        INFO(std::string(name));
        CHECK(turns.most.allocated_bytes <= turn_bytes_max);
        CHECK(turns.most.kept_bytes <= turn_bytes_max);
        CHECK(turns.most.faults <= turn_faults_max);
        CHECK(turns.most.scene_pages <= turn_scene_pages_max);
        CHECK(daemon.handlers_failed == 0);
        std::cout << "tally: a turn of the io thread for " << name << ": "
                  << turns.most.allocated_bytes << " bytes allocated, " << turns.most.kept_bytes
                  << " kept or freed, " << turns.most.faults << " pages touched, "
                  << turns.most.scene_pages << " of the scene\n";
    };
    const auto asks = [&](const auto& message) {
        return [&message](Turns& turns) { turns.ask(message); };
    };

    check("Info", asks(about_scene<wire::InfoT>()));
    check("Scenes", asks(wire::ScenesT{}));
    check("Stats", asks(wire::StatsT{}));
    check("Variants", asks(wire::VariantsT{}));
    wire::PartsT parts = about_scene<wire::PartsT>();
    parts.kind = "meshes";
    check("Parts", asks(parts));
    wire::PathT path = about_scene<wire::PathT>();
    path.path = 59'000;
    check("Path by number", asks(path));
    path.text = "no such instance";
    check("Path by text", asks(path));
    wire::StructureT structure = about_scene<wire::StructureT>();
    structure.kind = "placements";
    structure.count = 16384;
    check("Structure", asks(structure));
    wire::ExportT file = about_scene<wire::ExportT>();
    file.format = "glb";
    check("Export", asks(file));

    check("Query", asks(query("")));
    check("Query that hides", asks(query("", true)));
    wire::QueryT skips = query("", true);
    skips.job->skip_hidden_boxes = true;
    check("Query that skips hidden boxes", asks(skips));
    wire::QueryT hides = query("");
    hides.job->hidden_paths = {"*"};
    hides.job->only_path_ids = {7};
    check("Query that hides paths", asks(hides));
    check("Query that hides them again", asks(hides));
    hides.job->hidden_paths = {"no such instance"};
    check("Query that hides nothing known", asks(hides));
    for (const std::uint32_t other : {1U, 2U, 3U, 4U}) {
        hides.job->hidden_paths.clear();
        hides.job->only_path_ids = {other};
        check("Query for which another view gives way", asks(hides));
    }
    check("Query of visible pixels", asks(query("visible_pixels")));
    wire::QueryT timed = query("");
    timed.job->timed = true;
    timed.job->time = 0.5;
    timed.job->animation = std::to_string(motion_animations_max - 1) + "th";
    check("Query of another time", asks(timed));
    check("Query of that time again", asks(timed));
    timed.job->animation = "none";
    check("Query of an animation that is not there", asks(timed));
    check("Render of primary", asks(picture<wire::RenderT>(512, "raw")));
    check("Render that hides", asks(picture<wire::RenderT>(512, "raw", true)));
    check("Render of a film in tiles", asks(film(512, "raw")));
    check("Render of a film", asks(film(512, "linear")));
    check("Heatmap", asks(picture<wire::HeatmapT>(512, "json")));
    check("Blame", asks(picture<wire::BlameT>(256, "")));
    wire::ExplainT explain;
    explain.job = job(true);
    explain.width = explain.height = 64;
    explain.steps = 16384;
    check("Explain", asks(explain));
    check("Render that is cancelled", [&](Turns& turns) {
        for (const std::size_t steps : {0U, 1U, 2U, 5U, 20U}) {
            turns.ask(film(2048, "raw"));
            turns.run(steps);
            turns.tick();
            turns.send(protocol::encode(turns.id, wire::CancelT{}).value());
            turns.run();
        }
    });
    check("Unload", [&](Turns& turns) {
        SceneDescription another = large_scene();
        another.objects.front().name = "another";
        static_cast<void>(daemon.scenes.publish("another", build_scene(another), {},
                                                {"me", daemon.scenes.connect()}));
        wire::UnloadT unload;
        unload.scene = "another";
        turns.ask(unload);
    });
    const auto share_many = [&](bool temporary) {
        const server::ConnectionId holder{"me", daemon.scenes.connect()};
        std::vector<std::string> names;
        for (int i = 0; i < 510; ++i) names.push_back(std::string(100, 'x') + std::to_string(i));
        // Twice as many stay below the scenes of a principal.
        for (int i = 0; i < 96; ++i)
            REQUIRE(daemon.scenes.publish((temporary ? "t" : "s") + std::to_string(i), small,
                                          {.temporary = temporary, .share = names}, holder));
        return holder;
    };
    check("Scenes that are shared with many", [&](Turns& turns) {
        share_many(false);
        turns.ask(wire::ScenesT{});
    });
    check("the end of a connection that holds many scenes", [&](Turns& turns) {
        const auto holder = share_many(true);
        turns.turn([&] { daemon.scenes.disconnect(holder); });
    });
    const auto content_of_many = [&](std::size_t names) {
        std::vector<server::ConnectionId> owners;
        for (int i = 0; i < 8; ++i) {
            owners.push_back({std::string(100, 'o') + std::to_string(i), daemon.scenes.connect()});
            for (std::size_t k = 0; k < names; ++k)
                REQUIRE(daemon.scenes.publish("m" + std::to_string(k), small, {.temporary = true},
                                              owners.back()));
        }
        return owners;
    };
    check("the end of a connection that held nothing", [&](Turns& turns) {
        const auto owners = content_of_many(100);
        const server::ConnectionId stranger{"stranger", daemon.scenes.connect()};
        turns.turn([&] { daemon.scenes.disconnect(stranger); });
        CHECK(turns.most.allocated_bytes == 0);
        for (const auto& owner : owners) daemon.scenes.disconnect(owner);
    });
    check("the end of one of many owners of one content", [&](Turns& turns) {
        for (const auto& owner : content_of_many(200))
            turns.turn([&] { daemon.scenes.disconnect(owner); });
    });
    check("Pin", asks(about_scene<wire::PinT>()));
    check("Edit", [&](Turns& turns) {
        for (int round = 0; round < 3; ++round) {
            wire::EditT edit = about_scene<wire::EditT>();
            edit.targets = {"*"};
            edit.rows = 20;
            turns.ask(edit);
            turns.send(edit_rows(turns.id, edit.rows));
            turns.run();
        }
        const auto moved = daemon.scenes.find("large", 0, {"me", 0});
        REQUIRE(moved.has_value());
        CHECK(moved->epoch == 4);
    });
    check("a detached Query, Wait, Jobs, Fetch and CancelJob", [&](Turns& turns) {
        wire::QueryT detached = query("");
        detached.job->detach = true;
        turns.ask(detached);
        turns.run();
        turns.ask(wire::JobsT{});
        REQUIRE(daemon.detached.all().size() == 1);
        const std::uint64_t number = daemon.detached.all().begin()->first;
        wire::WaitT wait;
        wait.job = number;
        turns.ask(wait);
        turns.run();
        wire::FetchT fetch;
        fetch.job = number;
        turns.ask(fetch);
        turns.run();
        wire::CancelJobT cancel;
        cancel.job = number;
        turns.ask(cancel);
    });
    check("Unload all", [&](Turns& turns) {
        wire::UnloadT unload;
        unload.all = true;
        turns.ask(unload);
        turns.run();
        CHECK(daemon.scenes.list({"me", 0}).size() <= 1);
    });
    daemon.scenes.set_disposal({});

    // load_test and the whole daemon's tests have the others.
    const auto elsewhere = [](wire::Message type) {
        return type == wire::Message::Load || type == wire::Message::Page ||
               type == wire::Message::Admin || type == wire::Message::Backup ||
               type == wire::Message::Restore;
    };
#define RAYNEST_REQUEST(number, Name, ...)                                           \
    CHECK_MESSAGE((Turns::asked.contains(number) || elsewhere(wire::Message::Name)), \
                  "no turn of " #Name);
#include "protocol/lists/requests.def"
}

TEST_CASE("to read the dearest text messages takes the io thread no more than a turn may") {
    if (sanitized) return;
    const auto list = [](std::size_t count, std::string_view each) {
        std::string text;
        for (std::size_t i = 0; i < count; ++i) text.append(i == 0 ? "[" : ",").append(each);
        return text + ']';
    };
    const auto values = [&](const std::string& made) {
        return R"(Query 1 {"job":{"tables":[{"name":"a","values":)" + made + "}]}}";
    };
    const std::string texts[] = {
        values(list(9'000, "1e-300")),
        values(list(2'600, "1.2345678901234567e-30")),
        values(list(2'000, R"("1e-30")")),
        values(list(1, std::string(60'000, '9') + "e-60000")),
        R"(Query 1 {"job":{"hidden_instances":)" + list(9'990, "12345") + "}}",
        R"(Query 1 {"fields":)" + list(2'000, R"("")") + '}',
        R"(Query 1 {"job":{"tables":)" + list(protocol::Limits().control_tables_max, "{}") + "}}",
        R"(Info 1 {"scene":")" + std::string(65'000, '\\') + "\"}",
    };
    // The parser keeps the room that it took.
    for (const std::string& text : texts) CHECK(server::read_text_message(text).has_value());
    for (const std::string& text : texts) {
        CAPTURE(text.substr(0, 80));
        REQUIRE(text.size() <= 65'536);
        const std::uint64_t before = allocated_bytes;
        CHECK(server::read_text_message(text).has_value());
        CHECK(allocated_bytes - before <= turn_bytes_max);
    }
}

}  // namespace
}  // namespace raynest::test

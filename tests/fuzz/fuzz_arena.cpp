// Asks everything of a scene that a hostile import process has made: Snapshot::open() refuses its
// arena, or no request reads beyond it, and none goes on for ever.
//
// The input is a list of changes to a good arena, 9 bytes each: a place, a word, and how it is
// written.
#include "engine/scene/edits/pose.h"
#include "engine/scene/format.h"
#include "engine/scene/snapshot.h"
#include "tests/fuzz/target.h"
#include "tests/unit/engine/rich_scene.h"
#include "tests/unit/server/small_daemon.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <random>
#include <span>
#include <utility>

using namespace raynest;

namespace {

constexpr std::size_t change_bytes = 9;
constexpr std::size_t changes_max = 16;
/// Tasks and completions of one request: far more than those of a good scene take.
constexpr int steps_max = 2000;

std::span<const std::byte> good_arena() {
    static const std::shared_ptr<const Snapshot> scene = test::rich_scene(false);
    return scene->bytes();
}

/// Returns the place of a word in a section of the good arena, or in all of it. The sections differ
/// much in size, and the small ones lead to the others.
std::size_t place_in(std::size_t section, std::size_t number) {
    const std::span<const std::byte> good = good_arena();
    const auto& header = *reinterpret_cast<const format::Header*>(good.data());
    format::SectionEntry within{0, good.size(), 1, 0};
    if (const std::size_t at = section % (format::section_count + 1); at < format::section_count)
        if (header.sections[at].count != 0) within = header.sections[at];
    const std::uint64_t words = std::max<std::uint64_t>(within.count * within.element_size / 4, 1);
    return within.offset + number % words * 4;
}

Arena changed(std::span<const std::uint8_t> changes) {
    const std::span<const std::byte> good = good_arena();
    Arena arena(good.size());
    std::memcpy(arena.data(), good.data(), good.size());
    for (std::size_t i = 0; changes.size() >= change_bytes && i < changes_max; ++i) {
        std::uint32_t place = 0, word = 0;
        std::memcpy(&place, changes.data(), sizeof place);
        std::memcpy(&word, changes.data() + 4, sizeof word);
        std::byte* const at = arena.data() + place_in(changes[8] / 3, place);
        std::uint32_t value = 0;
        std::memcpy(&value, at, sizeof value);
        switch (changes[8] % 3) {
            case 0:
                value = word;
                break;
            case 1:
                value += word % 16 - 8;
                break;
            default:
                value ^= 1U << word % 32;
        }
        std::memcpy(at, &value, sizeof value);
        changes = changes.subspan(change_bytes);
    }
    return arena;
}

/// Rays for a query: from above, from within, and along the axes.
protocol::Frame rays(std::uint64_t id, std::uint64_t count) {
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, 8, count);
    bulk.allocate();
    const std::span<float> values = bulk.block_as<float>(0);
    for (std::uint64_t ray = 0; ray < count; ++ray) {
        const auto x = static_cast<float>(ray % 8), y = static_cast<float>(ray / 8 % 8);
        const std::array<float, 8> one = {x,
                                          y,
                                          ray % 3 == 0 ? 0.1F : 20,
                                          0,
                                          ray % 5 == 0 ? 0.3F : 0,
                                          ray % 2 == 0 ? -1.0F : 0,
                                          ray % 2 == 0 ? 0.0F : 1,
                                          100};
        std::copy(one.begin(), one.end(), values.begin() + static_cast<std::ptrdiff_t>(8 * ray));
    }
    return protocol::encode(id, wire::QueryRaysT{}, std::move(bulk)).value();
}

/// A client of a daemon that holds the scene, and all that it can ask of it.
class Curious {
public:
    explicit Curious(const std::shared_ptr<const Snapshot>& scene)
        : client_(daemon_, "owner", server::Role::admin) {
        client_.receive(protocol::encode(0, wire::HelloT{}).value());
        daemon_.scenes.publish("damaged", scene, {.share = {"public"}}, {"owner", 1}).value();
    }

    void ask_for_descriptions() {
        wire::InfoT info;
        info.scene = scene_name;
        ask(info);
        for (const char* kind : {"meshes", "materials"}) {
            wire::PartsT parts;
            parts.scene = scene_name;
            parts.kind = kind;
            ask(parts);
        }
        for (const char* kind : {"objects", "placements", "boxes"})
            for (std::uint16_t level = 0; level < 3; ++level) {
                wire::StructureT structure;
                structure.scene = scene_name;
                structure.kind = kind;
                structure.level = level;
                structure.depth_max = 4;
                ask(structure);
            }
        for (std::uint64_t number = 0; number < 9; number += 2) {
            wire::PathT path;
            path.scene = scene_name;
            path.path = number;
            ask(path);
        }
    }
    void ask_for_hits() {
        for (const char* kind : {"closest", "any", "multi", "all"})
            for (const char* traversal : {"single", "packet", "stream", "reference"}) {
                wire::QueryT query;
                query.kind = kind;
                query.ray_count = ray_count;
                query.max_hits = 8;
                query.fields = {"t", "prim", "path", "uv", "ng", "front", "position"};
                if (query.kind == "any") query.fields = {"hit"};
                query.job = job();
                query.job->traversal = traversal;
                client_.receive(protocol::encode(++id_, query).value());
                client_.receive(rays(id_, ray_count));
                settle();
            }
    }
    void ask_for_pictures() {
        for (const char* integrator : {"primary", "ao", "direct", "path"}) {
            auto render = picture<wire::RenderT>();
            render.integrator = integrator;
            render.samples = 2;
            ask(render);
        }
        auto heatmap = picture<wire::HeatmapT>();
        heatmap.metric = "total";
        ask(heatmap);
        wire::ExplainT explain;
        explain.job = job();
        explain.origin = std::make_unique<wire::Vec3>(0.3F, 0.3F, 5.0F);
        explain.direction = std::make_unique<wire::Vec3>(0.0F, 0.0F, -1.0F);
        explain.tmax = 100;
        explain.steps = 1000;
        ask(explain);
        wire::BlameT blame;
        blame.job = job();
        blame.camera = camera();
        blame.width = blame.height = side;
        blame.top = 20;
        ask(blame);
    }
    std::size_t answers = 0;  ///< but for errors

private:
    static constexpr const char* scene_name = "damaged";
    static constexpr std::uint64_t ray_count = 64;
    static constexpr std::uint32_t side = 16;

    static std::unique_ptr<wire::JobT> job() {
        auto job = std::make_unique<wire::JobT>();
        job->scene = scene_name;
        return job;
    }
    static std::unique_ptr<wire::CameraT> camera() {
        auto camera = std::make_unique<wire::CameraT>();
        camera->look_at = true;
        camera->eye = std::make_unique<wire::Vec3>(4.0F, 4.0F, 9.0F);
        camera->at = std::make_unique<wire::Vec3>(1.0F, 1.0F, 0.0F);
        return camera;
    }
    template <class Picture>
    static Picture picture() {
        Picture picture;
        picture.job = job();
        picture.camera = camera();
        picture.width = picture.height = side;
        picture.encode = "raw";
        return picture;
    }
    template <class Native>
    void ask(const Native& message) {
        client_.receive(protocol::encode(++id_, message).value());
        settle();
    }
    void settle() {
        int step = 0;
        while (step < steps_max && daemon_.step()) ++step;
        fuzz::require(step < steps_max);
        for (const protocol::Frame& frame : daemon_.sent)
            answers += frame.header.type != static_cast<std::uint16_t>(wire::Message::Error);
        daemon_.sent.clear();
    }

    test::SmallDaemon daemon_;
    test::Client client_;
    std::uint64_t id_ = 0;
};

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds = {{}};
    std::mt19937 random(7);
    for (int seed = 0; seed < 200; ++seed) {
        Input input(change_bytes * (1 + random() % 2));
        for (std::uint8_t& byte : input) byte = static_cast<std::uint8_t>(random());
        seeds.push_back(std::move(input));
    }
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const auto scene = Snapshot::open({changed({data, size})});
    if (!scene) return 0;
    Curious client(*scene);
    client.ask_for_descriptions();
    client.ask_for_hits();
    client.ask_for_pictures();
    for (std::uint32_t i = 0; i < animations_of(**scene).size(); ++i)
        for (const double share : {0.0, 0.3, 1.0}) {
            const auto posed = pose(**scene, {i, share * animations_of(**scene)[i].seconds});
            fuzz::require(posed.has_value() || size != 0);
        }
    // The good arena answers all.
    fuzz::require(size != 0 || client.answers > 40);
    return 0;
}

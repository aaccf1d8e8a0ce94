// The file that brings a device's process the changes of an edited scene.
#include "engine/scene/edits/edit.h"
#include "engine/scene/format.h"
#include "server/backends/cuda/scene_changes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <vector>

using namespace raynest;
using namespace raynest::server::device;

namespace {

using Scene = std::shared_ptr<const Snapshot>;

Scene squares(std::uint32_t count) {
    SceneDescription scene;
    scene.objects.resize(2);
    scene.objects[0].geometries.push_back(test::unit_square());
    for (std::uint32_t i = 0; i < count; ++i)
        scene.objects[1].instances.push_back(
            test::place(0, test::translation(static_cast<float>(2 * i), 0, 0)));
    scene.root = 1;
    return test::build_scene(scene);
}

Scene lifted(const Snapshot& scene, std::uint32_t instance) {
    Transform to = scene.view().instance_infos[instance].to_parent;
    to.m[7] += 0.25F;
    auto edited = edit_scene(scene, {.moves = {{instance, to}}});
    REQUIRE_MESSAGE(edited, edited.error().message);
    return *edited;
}

/// The bytes of an array in an arena.
std::span<const std::byte> array_of(const Snapshot& scene, format::Section which) {
    const auto& header = *reinterpret_cast<const format::Header*>(scene.bytes().data());
    const format::SectionEntry& section = header.sections[static_cast<std::size_t>(which)];
    return scene.bytes().subspan(section.offset, section.count * section.element_size);
}

/// Puts changes into a copy of an array.
template <class T>
std::vector<std::byte> patched(std::span<const std::byte> array, SceneArray which,
                               std::span<const ChangedRange> changes) {
    std::vector<std::byte> to(array.begin(), array.end());
    for (const ChangedRange& change : changes) {
        if (change.array != which) continue;
        REQUIRE((change.first + change.count) * sizeof(T) <= to.size());
        std::memcpy(to.data() + change.first * sizeof(T), change.elements,
                    change.count * sizeof(T));
    }
    return to;
}

/// Why a file is refused that says that it has so many ranges.
std::string refusal(std::vector<std::byte> file, std::uint64_t ranges) {
    std::memcpy(file.data(), &ranges, sizeof ranges);
    const auto read = read_changes(file);
    return read ? std::string() : read.error().message;
}

}  // namespace

TEST_CASE("a scene knows what has changed since the last scenes that it was edited from") {
    std::vector<Scene> epochs{squares(3000)};
    for (std::uint32_t i = 0; i < edits_remembered + 1; ++i)
        epochs.push_back(lifted(*epochs.back(), 40 * i));
    const auto since = [&](std::size_t epoch) {
        return epochs.back()->edited_from(
            [&](const std::string& id) { return id == epochs[epoch]->arena_id(); });
    };
    CHECK_FALSE(since(0).has_value());
    CHECK_FALSE(epochs[0]->edited_from([](const std::string&) { return true; }).has_value());
    const auto last = epochs.back()->edited_from([](const std::string&) { return true; });
    REQUIRE(last.has_value());
    CHECK(last->arena_id == epochs[edits_remembered]->arena_id());

    for (const std::size_t epoch : {std::size_t{1}, edits_remembered - 3, edits_remembered}) {
        CAPTURE(epoch);
        const auto from = since(epoch);
        REQUIRE(from.has_value());
        const Snapshot& scene = *epochs.back();
        const auto heads = changed_ranges(scene.bytes(), from->changed);
        const auto file = changes_file(scene.bytes(), heads);
        CHECK(file.size() == changes_bytes(heads));
        CHECK(file.size() < scene.bytes().size() / (epoch == edits_remembered ? 10 : 1));
        const auto changes = read_changes(file);
        REQUIRE_MESSAGE(changes, changes.error().message);
        const auto agrees = [&]<class T>(SceneArray which, format::Section section) {
            const auto before = array_of(*epochs[epoch], section);
            const auto after = array_of(scene, section);
            CHECK_FALSE(std::memcmp(before.data(), after.data(), after.size()) == 0);
            const auto now = patched<T>(before, which, *changes);
            CHECK(std::memcmp(now.data(), after.data(), after.size()) == 0);
        };
        agrees.operator()<Node>(array_nodes, format::Section::nodes);
        agrees.operator()<InstanceRecord>(array_instances, format::Section::instances);
        for (const ChangedRange& change : *changes)
            CHECK((change.array == array_nodes || change.array == array_objects ||
                   change.array == array_instances));
    }
}

TEST_CASE("changes that are not what their heads say are refused") {
    const Scene scene = squares(100);
    const std::vector<RangeHead> heads{{array_nodes, 0, 0, 2}, {array_instances, 0, 5, 3}};
    std::vector<std::byte> file = changes_file(scene->bytes(), heads);
    CHECK(file.size() == 64 + 2 * sizeof(Node) + 3 * sizeof(InstanceRecord));
    CHECK(refusal(file, 2).empty());
    CHECK(refusal(changes_file(scene->bytes(), {}), 0).empty());
    const auto refuses = [](const std::string& why, const char* with) {
        CHECK_MESSAGE(why.find(with) != std::string::npos, why);
    };
    refuses(read_changes({}).error().message, "no number of ranges");
    refuses(refusal(file, 0), "go on behind");
    refuses(refusal(file, 1), "go on behind");
    refuses(refusal(file, 100), "end within their heads");
    refuses(refusal(file, changed_ranges_max + 1), "too many ranges");
    refuses(refusal(file, ~0ULL), "too many ranges");
    refuses(refusal({file.begin(), file.end() - 1}, 2), "end within their elements");
    file.push_back(std::byte{0});
    refuses(refusal(file, 2), "go on behind");
    file.pop_back();
    const auto with = [&](RangeHead head) {
        std::vector<std::byte> other = file;
        std::memcpy(other.data() + sizeof(std::uint64_t), &head, sizeof head);
        return refusal(other, 2);
    };
    CHECK(with(heads[0]).empty());
    refuses(with({array_count, 0, 0, 2}), "no scene has");
    refuses(with({array_nodes, 0, 0, ~0ULL}), "end within");
    refuses(with({array_nodes, 0, 0, 1ULL << 56}), "end within");
}

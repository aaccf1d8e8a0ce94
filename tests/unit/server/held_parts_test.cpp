// Files of an upload whose bytes follow from a scene that the client may see are not asked for.
#include "server/store/held_parts.h"

#include "engine/assets/formats/part_file.h"
#include "protocol/openssl.h"
#include "server/requests/request.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <vector>

namespace raynest::server {
namespace {

using test::SmallDaemon;
using Bytes = std::vector<std::byte>;

/// A sheet of 20 x 20 vertices.
std::shared_ptr<const Snapshot> sheet_of(float height) {
    constexpr std::uint32_t side = 20;
    SceneDescription scene;
    scene.objects.resize(1);
    GeometryDescription& sheet = scene.objects[0].geometries.emplace_back();
    for (std::uint32_t i = 0; i < side * side; ++i) {
        sheet.positions.emplace_back(i % side, i / side, height);
        if (i % side == side - 1 || i / side == side - 1) continue;
        sheet.indices.insert(sheet.indices.end(), {i, i + 1, i + side});
        sheet.indices.insert(sheet.indices.end(), {i + 1, i + side + 1, i + side});
    }
    return test::build_scene(scene);
}

Bytes bytes_of(const PartFile& file) {
    Bytes bytes;
    file.write([&](std::span<const std::byte> piece) {
        bytes.insert(bytes.end(), piece.begin(), piece.end());
        return true;
    });
    CHECK(bytes.size() == file.bytes());
    return bytes;
}

/// Files of the first large part: as a glTF buffer, and as a PLY.
std::vector<Bytes> part_of(const Snapshot& scene) {
    const SceneView& view = scene.view();
    std::vector<Bytes> made;
    for (std::uint32_t i = 0; i < view.object_count && made.empty(); ++i)
        for (const PartFile& file : part_files(view, view.objects[i]))
            made.push_back(bytes_of(file));
    REQUIRE(made.size() == 2);
    return made;
}

/// A sheet that everybody may see.
std::shared_ptr<const Snapshot> held_sheet(SmallDaemon& daemon) {
    auto sheet = sheet_of(1);
    REQUIRE(daemon.scenes.publish("sheet", sheet, {.share = {"public"}}, {"owner", 7}));
    return sheet;
}

protocol::Sha256Digest digest_of(const Bytes& bytes) {
    protocol::Sha256 sum;
    sum.add(bytes);
    return *sum.digest();
}

/// A load of these files, and of a main file of zeros.
std::unique_ptr<Job> load_of(SmallDaemon& daemon, const std::vector<Bytes>& parts) {
    wire::LoadT message;
    message.source = "parts.glb";
    std::vector<Bytes> files{Bytes(100)};
    files.insert(files.end(), parts.begin(), parts.end());
    for (const Bytes& file : files) {
        const auto digest = digest_of(file);
        message.file_digests.insert(message.file_digests.end(), digest.begin(), digest.end());
        message.file_bytes.push_back(file.size());
        message.file_names.push_back("file" + std::to_string(message.file_names.size()));
    }
    message.file_names[0] = message.source;
    const auto frame = protocol::encode(1, message, daemon.limits).value();
    const auto opened = protocol::open<wire::Load>(frame, daemon.limits);
    REQUIRE(opened);
    auto answer = load(daemon.services, {{"me", 1}, 1, 1 << 20}, *opened);
    REQUIRE_MESSAGE(answer, (answer ? "" : answer.error().message));
    return std::move(std::get<JobSubmission>(*answer).job);
}

/// The files that the daemon asks for.
std::vector<std::uint32_t> asked(Job& job) {
    const StopFlag stop(Clock::time_point::max());
    if (auto search = job.prepare()) REQUIRE(search->run(stop));
    const Frames frames = job.greeting();
    if (frames.empty()) return {};
    const auto need = protocol::open<wire::Need>(frames.front());
    REQUIRE(need);
    std::vector<std::uint32_t> files;
    if (const auto* const list = (*need)->files(); list != nullptr)
        for (std::uint32_t i = 0; i < list->size(); ++i) files.push_back(list->Get(i));
    return files;
}

TEST_CASE("a file of a part that the caller may see is not asked for, in either format") {
    SmallDaemon daemon;
    const auto hidden = sheet_of(3);
    REQUIRE(daemon.scenes.publish("hidden", hidden, {}, {"owner", daemon.scenes.connect()}));
    const auto seen = part_of(*held_sheet(daemon));
    CHECK(asked(*load_of(daemon, {part_of(*hidden)[0], seen[0]})) ==
          std::vector<std::uint32_t>{0, 1});
    CHECK(asked(*load_of(daemon, {seen[1], seen[0]})) == std::vector<std::uint32_t>{0});
    // One of two equal files is found, so that a short message cannot fill the memory.
    CHECK(asked(*load_of(daemon, {seen[1], seen[1]})).size() == 2);
    Bytes other = seen[0];
    other.back() ^= std::byte{1};
    CHECK(asked(*load_of(daemon, {other})) == std::vector<std::uint32_t>{0, 1});
}

TEST_CASE("files that are found are charged for, and asked for where there is no room") {
    SmallDaemon daemon;
    const auto seen = part_of(*held_sheet(daemon));
    const std::uint64_t before = daemon.budget.held_by("me");
    const auto job = load_of(daemon, {seen[0]});
    CHECK(asked(*job) == std::vector<std::uint32_t>{0});
    CHECK(daemon.budget.held_by("me") == before + seen[0].size());
    CHECK(job->held_bytes() == seen[0].size());

    const auto late = load_of(daemon, {seen[0]});
    const auto taken = daemon.budget.reserve(daemon.budget.limit() - daemon.budget.used() - 10);
    REQUIRE(taken);
    CHECK(asked(*late) == std::vector<std::uint32_t>{0, 1});
}

TEST_CASE("pieces that come while the daemon searches are refused") {
    SmallDaemon daemon;
    const auto seen = part_of(*held_sheet(daemon));
    const auto job = load_of(daemon, {seen[0]});
    const auto search = job->prepare();
    REQUIRE(search);
    CHECK_FALSE(job->needs_input());
    const auto early = job->feed(test::piece_of(10));
    REQUIRE_FALSE(early);
    CHECK(early.error().code == Code::invalid_field);
}

TEST_CASE("a search hashes a part once, and no more than 16 times what is wanted") {
    SmallDaemon daemon;
    constexpr std::size_t count = 20;
    std::vector<std::shared_ptr<const Snapshot>> sheets;
    for (std::size_t i = 0; i < count; ++i) {
        sheets.push_back(sheet_of(static_cast<float>(i)));
        REQUIRE(daemon.scenes.publish("sheet" + std::to_string(i), sheets[i], {}, {"me", 1}));
    }
    const StopFlag stop(Clock::time_point::max());
    const auto found_of_all = [&](bool is_all_forgotten) {
        std::size_t found = 0;
        for (const auto& sheet : sheets) {
            const Bytes file = part_of(*sheet)[0];
            const auto digest = digest_of(file);
            Bytes into(file.size());
            const WantedFile wanted{&digest, into};
            const auto scenes = daemon.scenes.visible_scenes({"me", 1});
            if (is_all_forgotten)
                for (const auto& scene : scenes)
                    scene->part_digests = std::make_shared<PartDigests>();
            const auto filled = fill_in_held_parts(
                scenes, {&wanted, 1}, [](std::uint64_t) { return true; }, stop);
            CHECK((into == file) == filled[0]);
            found += filled[0] ? 1U : 0U;
        }
        return found;
    };
    CHECK(found_of_all(true) == 16);
    CHECK(found_of_all(false) >= 16);
    CHECK(found_of_all(false) == count);
}

}  // namespace
}  // namespace raynest::server

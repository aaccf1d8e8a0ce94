// The state folder: what is on the disk after each step, and what is refused.
#include "server/store/state_folder.h"

#include "server/store/scene_store.h"
#include "tests/temporary_folder.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>
#include <sqlite3.h>

#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <vector>

namespace raynest::server {
namespace {

namespace fs = std::filesystem;

using test::square;

bool never() {
    return false;
}

std::set<std::string> names_in(const fs::path& folder) {
    std::set<std::string> names;
    for (const auto& file : fs::directory_iterator(folder))
        names.insert(file.path().filename().string());
    return names;
}

StoredScene row(const std::string& name, const Snapshot& scene, std::uint64_t number) {
    return {.number = number,
            .owner = "CN=a,O=b",
            .name = name,
            .share = {"public", "CN=robot,O=Lab"},
            .digest = scene.arena_id(),
            .content = scene.digest(),
            .epoch = 3,
            .bytes = scene.bytes().size(),
            .instanced_triangles = 7,
            .build_seconds = 0.1,
            .used = 5};
}

struct Folder {
    test::TemporaryFolder folder;
    const fs::path path = folder.path();
    const fs::path blobs = path / "blobs";
    const std::shared_ptr<const Snapshot> one = square(1);
    const std::shared_ptr<const Snapshot> two = square(2);

    std::unique_ptr<StateFolder> open() const { return StateFolder::open(path).value(); }
    void store(StateFolder& state, const std::string& name, const Snapshot& scene) const {
        const auto pin = state.keep(scene.arena_id(), scene.bytes(), never).value();
        REQUIRE(state.put(row(name, scene, state.next_number())));
    }
    void run(const char* sql) const {
        sqlite3* database = nullptr;
        REQUIRE(sqlite3_open((path / "manifest.sqlite").c_str(), &database) == SQLITE_OK);
        CHECK(sqlite3_exec(database, sql, nullptr, nullptr, nullptr) == SQLITE_OK);
        sqlite3_close(database);
    }
    std::string refusal() const {
        const auto state = StateFolder::open(path);
        REQUIRE(!state);
        return state.error().message;
    }
};

}  // namespace

TEST_CASE("a stored scene is found again as it was") {
    const Folder test;
    test.store(*test.open(), "a", *test.one);
    const auto state = test.open();
    REQUIRE(state->found().size() == 1);
    const StoredScene& found = state->found()[0];
    const StoredScene put = row("a", *test.one, 1);
    CHECK(found.number == put.number);
    CHECK(found.owner == put.owner);
    CHECK(found.share == put.share);
    CHECK(found.digest == put.digest);
    CHECK(found.content == put.content);
    CHECK(found.epoch == put.epoch);
    CHECK(found.build_seconds == put.build_seconds);
    CHECK(state->next_number() == 2);
    const auto read = read_stored(test.path, found.digest, found.bytes, found.content);
    REQUIRE(read);
    CHECK((*read)->digest() == test.one->digest());
}

TEST_CASE("a blob stays while it has a row or a pin") {
    const Folder test;
    const auto state = test.open();
    test.store(*state, "a", *test.one);
    test.store(*state, "b", *test.one);
    const auto blobs = [&] { return names_in(test.blobs); };
    REQUIRE(state->remove({row("a", *test.one, 9)}));
    CHECK(blobs() == std::set{test.one->arena_id()});
    auto pin = state->pin(test.one->arena_id());
    test.store(*state, "b", *test.two);
    CHECK(blobs().size() == 2);
    pin.reset();
    CHECK(state->has_work());
    state->collect();
    CHECK(blobs() == std::set{test.two->arena_id()});
    // A removal that comes late does not remove a later row.
    REQUIRE(state->remove({row("b", *test.two, 2)}));
    CHECK(blobs() == std::set{test.two->arena_id()});
}

TEST_CASE("a start removes what a killed daemon has left half") {
    const Folder test;
    {
        const auto state = test.open();
        test.store(*state, "a", *test.one);
        const auto pin = state->keep(test.two->arena_id(), test.two->bytes(), never).value();
        std::ofstream(test.blobs / ".new-7") << "half";
    }
    CHECK(names_in(test.blobs).size() == 3);
    CHECK(test.open()->found().size() == 1);
    CHECK(names_in(test.blobs) == std::set{test.one->arena_id()});
}

TEST_CASE("a load that is stopped after its commit leaves the scene before") {
    const Folder test;
    const auto state = test.open();
    test.store(*state, "a", *test.one);
    const auto pin = state->pin(test.one->arena_id());
    test.store(*state, "a", *test.two);
    state->undo(row("a", *test.two, 2), std::make_unique<StoredScene>(row("a", *test.one, 1)));
    CHECK(state->has_work());
    state->collect();
    CHECK(names_in(test.blobs) == std::set{test.one->arena_id()});
    test.store(*state, "b", *test.two);
    state->undo(row("b", *test.two, 3), nullptr);
    state->collect();
    CHECK(names_in(test.blobs) == std::set{test.one->arena_id()});
}

TEST_CASE("a blob that is not as it was written is found out, and written anew after that") {
    const Folder test;
    const auto state = test.open();
    test.store(*state, "a", *test.one);
    const std::string digest = test.one->arena_id();
    const std::uint64_t bytes = test.one->bytes().size();
    CHECK(read_stored(test.path, digest, bytes + 1, {}).error().damaged);
    for (const std::uint64_t at : {std::uint64_t{0}, bytes / 2, bytes - 1}) {
        std::fstream file(test.blobs / digest, std::ios::in | std::ios::out | std::ios::binary);
        file.seekp(static_cast<std::streamoff>(at));
        const auto good = static_cast<char>(test.one->bytes()[at]);
        file.put(static_cast<char>(good ^ 1)).flush();
        CHECK(read_stored(test.path, digest, bytes, {}).error().damaged);
        file.seekp(static_cast<std::streamoff>(at));
        file.put(good).flush();
        CHECK(read_stored(test.path, digest, bytes, {}));
    }
    // The same bytes as a new file, as a load writes them while the damaged ones are read.
    const std::uint64_t damaged = read_stored(test.path, digest, bytes + 1, {}).error().inode;
    std::filesystem::copy_file(test.blobs / digest, test.blobs / ".again");
    std::filesystem::rename(test.blobs / ".again", test.blobs / digest);
    state->set_aside(digest, damaged);
    CHECK(names_in(test.path / "damaged").empty());
    const std::uint64_t now = read_stored(test.path, digest, bytes + 1, {}).error().inode;
    state->set_aside(digest, now);
    CHECK(names_in(test.path / "damaged") == std::set{digest});
    CHECK(read_stored(test.path, digest, bytes, {}).error().why == "its file is gone");
    REQUIRE(state->keep(digest, test.one->bytes(), never));
    CHECK(read_stored(test.path, digest, bytes, {}));
}

TEST_CASE("a write that is stopped leaves nothing") {
    const Folder test;
    const auto state = test.open();
    CHECK(!state->keep(test.one->arena_id(), test.one->bytes(), [] { return true; }));
    CHECK(names_in(test.blobs).empty());
}

TEST_CASE("nothing is written that the next start would refuse, nor read that has any length") {
    const Folder test;
    {
        const auto state = test.open();
        test.store(*state, "a", *test.one);
        StoredScene late = row("b", *test.one, state->next_number());
        late.epoch = 1ULL << 62;
        CHECK_FALSE(state->put(late));
    }
    CHECK(test.open()->found().size() == 1);
    test.run("ALTER TABLE scenes ADD COLUMN more TEXT NOT NULL DEFAULT 'long'");
    CHECK(test.refusal().find("its column more is computed, or has a default") !=
          std::string::npos);
}

TEST_CASE("a manifest that is not as it was written refuses the start") {
    const Folder test;
    test.store(*test.open(), "a", *test.one);
    test.run("UPDATE scenes SET share='mallory'");
    CHECK(test.refusal().find("row 1 is not as it was written") != std::string::npos);
    CHECK(names_in(test.blobs).size() == 1);
    test.run("PRAGMA user_version=99");
    CHECK(test.refusal().find("a newer one wrote it") != std::string::npos);
    test.run("PRAGMA user_version=3; PRAGMA application_id=5");
    CHECK(test.refusal().find("it is not one of raynestd") != std::string::npos);
}

TEST_CASE("a row that no release has written refuses the start, whatever its checksum says") {
    const std::vector<void (*)(StoredScene&)> forgeries = {
        [](StoredScene& row) { row.number = ~0ULL; },
        [](StoredScene& row) { row.epoch = 0; },
        [](StoredScene& row) { row.epoch = ~0ULL; },
        [](StoredScene& row) { row.bytes = ~0ULL; },
        [](StoredScene& row) { row.used = -1; },
        [](StoredScene& row) { row.used = std::numeric_limits<std::int64_t>::max() / 2; },
        [](StoredScene& row) { row.owner.clear(); },
        [](StoredScene& row) { row.name = "two\nlines"; },
        [](StoredScene& row) { row.name = "\xFF"; },
        [](StoredScene& row) { row.name.assign(1 << 20, 'n'); },
        [](StoredScene& row) { row.digest = "../../etc/passwd"; },
        [](StoredScene& row) { row.content.assign(1 << 20, 'c'); },
    };
    for (std::size_t i = 0; i < forgeries.size(); ++i) {
        CAPTURE(i);
        const Folder test;
        test.store(*test.open(), "a", *test.one);
        StoredScene forged = row("b", *test.one, 2);
        forgeries[i](forged);
        REQUIRE(Manifest::open(test.path / "manifest.sqlite")->put(forged));
        CHECK(test.refusal().find("is not as it was written") != std::string::npos);
    }
    const Folder test;
    test.store(*test.open(), "a", *test.one);
    test.run("INSERT INTO edits VALUES(1, 1000, 3, '', 0, 0, X'', 12345)");
    CHECK(test.refusal().find("epoch 1000 of scene 1 is not as it was written") !=
          std::string::npos);
}

TEST_CASE("a folder of blobs behind a link is left alone") {
    const Folder test;
    const test::TemporaryFolder documents;
    std::ofstream(documents.path() / "thesis.txt") << "years";
    fs::create_directory_symlink(documents.path(), test.blobs);
    CHECK(test.refusal().find("not a link to one") != std::string::npos);
    CHECK(fs::exists(documents.path() / "thesis.txt"));
}

TEST_CASE("an edit that does not follow the one before is named") {
    const std::vector<KeptEdit> edits = {{.number = 1, .epoch = 3, .before = 2},
                                         {.number = 1, .epoch = 7, .before = 3}};
    CHECK(gap_in(edits, 2).empty());
    CHECK(gap_in({}, 2).empty());
    CHECK(gap_in(edits, 1) == "its edit of epoch 3 follows epoch 2, not 1");
    CHECK(gap_in({edits[1]}, 2) == "its edit of epoch 7 follows epoch 3, not 2");
}

TEST_CASE("a manifest of a release that did not note the content is read, and written on") {
    const Folder test;
    {
        const auto state = test.open();
        const auto pin = state->keep(test.one->arena_id(), test.one->bytes(), never).value();
        StoredScene old = row("a", *test.one, state->next_number());
        old.content.clear();
        REQUIRE(state->put(old));
    }
    test.run("ALTER TABLE scenes DROP COLUMN content; PRAGMA user_version=2");
    CHECK(Manifest::open(test.path / "manifest.sqlite", true)->rows().value().size() == 1);
    {
        const auto state = test.open();
        REQUIRE(state->found().size() == 1);
        const StoredScene& found = state->found()[0];
        CHECK(found.content.empty());
        const auto read = read_stored(test.path, found.digest, found.bytes, found.content);
        REQUIRE(read);
        CHECK((*read)->digest() == test.one->digest());
        test.store(*state, "b", *test.two);
    }
    CHECK(test.open()->found()[1].content == test.two->digest());
}

TEST_CASE("network file systems are known by name") {
    CHECK(network_file_system(0x6969) == std::string("NFS"));
    CHECK(network_file_system(0x65735546) == std::string("FUSE"));
    CHECK(network_file_system(0xFF534D42) == std::string("CIFS"));
    CHECK(network_file_system(0xEF53) == nullptr);      // ext4
    CHECK(network_file_system(0x01021994) == nullptr);  // tmpfs
}

TEST_CASE("loads of one name follow each other") {
    const Folder test;
    const auto state = test.open();
    auto first = state->lock_name("me", "a", never);
    CHECK(state->lock_name("me", "b", never) != nullptr);
    CHECK(state->lock_name("me", "a", [] { return true; }) == nullptr);
    std::thread second([&] { CHECK(state->lock_name("me", "a", never) != nullptr); });
    first.reset();
    second.join();
}

}  // namespace raynest::server

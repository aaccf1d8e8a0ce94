#include "client/requests/upload.h"

#include "client/files/files.h"
#include "protocol/hash.h"
#include "tests/temporary_folder.h"
#include "tests/unit/client/fake_daemon.h"

#include <doctest/doctest.h>
#include <sys/stat.h>

#include <ctime>
#include <filesystem>
#include <fstream>
#include <set>
#include <string>
#include <thread>

using namespace raynest;
using client::gather;
using client::Upload;
using test::TemporaryFolder;

namespace {

constexpr const char* two_files =
    R"({"asset":{"version":"2.0"},"buffers":[{"uri":"a%20b.bin"}],"images":[{"uri":"t/leaf.png"}]})";

TemporaryFolder& sample_folder() {
    static TemporaryFolder folder;
    folder.write("scene.gltf", two_files);
    folder.write("a b.bin", "buffer");
    folder.write("t/leaf.png", "");
    return folder;
}

}  // namespace

TEST_CASE("a glTF is gathered with the files that it names") {
    const auto upload = gather(sample_folder().file("scene.gltf"), "", "");
    REQUIRE(upload);
    CHECK(upload->source == "scene.gltf");
    CHECK(upload->scene_name == "scene");
    REQUIRE(upload->files.size() == 3);
    CHECK(upload->files[0].name == "scene.gltf");
    CHECK(upload->files[1].name == "a b.bin");
    CHECK(upload->files[2].name == "t/leaf.png");
    CHECK(upload->files[1].bytes.size() == 6);
    const std::string text = "buffer";
    protocol::Sha256 sum;
    sum.add(std::as_bytes(std::span(text)));
    CHECK(upload->files[1].digest == sum.digest());
}

TEST_CASE("the hash is FNV-1a") {
    const std::string text = "foobar";
    CHECK(protocol::upload_checksum({}) == 0xCBF29CE484222325ULL);
    const auto bytes = std::as_bytes(std::span(text));
    CHECK(protocol::upload_checksum(bytes) == 0x85944171F73967E8ULL);
    CHECK(protocol::upload_checksum(bytes.subspan(2), protocol::upload_checksum(bytes.first(2))) ==
          0x85944171F73967E8ULL);
}

TEST_CASE("sources without files are sent as they are, and the daemon names the scene") {
    for (const char* source : {"builtin:forest?trees=9", "root:maps/town.glb"}) {
        const auto upload = gather(source, "", "");
        REQUIRE(upload);
        CHECK(upload->source == source);
        CHECK(upload->scene_name.empty());
        CHECK(upload->files.empty());
    }
}

TEST_CASE("records come with the name of their primitive and their instances") {
    const TemporaryFolder folder;
    folder.write("balls.npy", "x");
    folder.write("places.npy", "y");
    const auto upload = gather(folder.file("balls.npy"), "sphere", folder.file("places.npy"));
    REQUIRE(upload);
    CHECK(upload->source == "balls.npy");
    CHECK(upload->scene_name == "balls");
    REQUIRE(upload->files.size() == 2);
    CHECK(upload->files[0].name == "balls.npy");
    CHECK(upload->files[1].name == "places.npy");
    const auto nameless = gather(folder.file("balls.npy"), "", "");
    REQUIRE(!nameless);
    CHECK(nameless.error().exit == protocol::Exit::usage);
}

TEST_CASE("bad sources end with exit code 5 before anything is sent") {
    const TemporaryFolder folder;
    folder.write("pipe.gltf", R"({"buffers":[{"uri":"pipe"}]})");
    REQUIRE(::mkfifo(folder.file("pipe").c_str(), 0600) == 0);
    folder.write("outside.gltf", R"({"buffers":[{"uri":"link"}]})");
    std::filesystem::create_symlink("/etc/passwd", folder.file("link"));
    folder.write("text.txt", "x");
    folder.write("cut.glb", "glTF\x02");
    for (const char* name :
         {"pipe.gltf", "outside.gltf", "text.txt", "cut.glb", "missing.glb", ""}) {
        const auto upload = gather(folder.file(name), "", "");
        REQUIRE(!upload);
        CHECK(upload.error().exit == protocol::Exit::invalid);
    }
}

TEST_CASE("a picture that cannot be read is left out with a warning") {
    const TemporaryFolder folder;
    folder.write("scene.gltf", R"({"images":[{"uri":"link"},{"uri":"sub"},{"uri":"b.png"}]})");
    folder.write("sub/x", "");
    folder.write("b.png", "x");
    std::filesystem::create_symlink("/etc/passwd", folder.file("link"));
    const auto upload = gather(folder.file("scene.gltf"), "", "");
    REQUIRE(upload);
    REQUIRE(upload->files.size() == 2);
    CHECK(upload->files[1].name == "b.png");
    REQUIRE(upload->warnings.size() == 2);
    CHECK(upload->warnings[0].find("link leaves the folder") != std::string::npos);
    CHECK(upload->warnings[1].find("sub: is not a regular file") != std::string::npos);
}

TEST_CASE("a file or pipe without a known ending is told by its first bytes") {
    const TemporaryFolder folder;
    folder.write("scene", two_files);
    folder.write("a b.bin", "buffer");
    folder.write("town.json", two_files);
    for (const auto& [file, name] : {std::pair{"scene", "scene"}, {"town.json", "town"}}) {
        const auto upload = gather(folder.file(file), "", "");
        REQUIRE(upload);
        CHECK(upload->source == file + std::string(".gltf"));
        CHECK(upload->scene_name == name);
        CHECK(upload->files.size() == 2);
    }
    REQUIRE(::mkfifo(folder.file("pipe").c_str(), 0600) == 0);
    std::thread writer([&] { std::ofstream(folder.file("pipe")) << two_files; });
    const auto piped = gather(folder.file("pipe"), "", "");
    writer.join();
    REQUIRE(piped);
    CHECK(piped->source == "pipe.gltf");
    CHECK(piped->scene_name == "pipe");
    CHECK(piped->files.size() == 2);
}

TEST_CASE("files that are missing, outside, or the scene itself are left out") {
    const TemporaryFolder folder;
    folder.write("a.gltf", R"({"buffers":[{"uri":"gone.bin"},{"uri":"a.gltf"},{"uri":"./b.bin"}],
        "images":[{"uri":"../x.png"},{"uri":"http://x/y.png"},{"uri":"none/z.png"}]})");
    folder.write("b.bin", "x");
    const auto upload = gather(folder.file("a.gltf"), "", "");
    REQUIRE(upload);
    REQUIRE(upload->files.size() == 2);
    CHECK(upload->files[1].name == "b.bin");
}

TEST_CASE("only what the daemon needs is sent, in pieces that fit its credit") {
    const TemporaryFolder folder;
    const std::string large(300000, 'z');
    folder.write("scene.gltf", two_files);
    folder.write("a b.bin", large);
    folder.write("t/leaf.png", "");
    const auto upload = gather(folder.file("scene.gltf"), "", "");
    REQUIRE(upload);

    constexpr std::uint64_t window = 128U << 10;
    std::string received;
    {
        client::FakeDaemon daemon([&](client::Peer& peer) {
            peer.welcome(window);
            const std::uint64_t id = peer.receive().header.request_id;
            std::uint64_t outstanding = 0;
            while (received.size() < large.size()) {
                const protocol::Frame frame = peer.receive();
                const auto piece = protocol::open<wire::Upload>(frame);
                if (!piece) return;
                CHECK((*piece)->file() == 1);
                CHECK((*piece)->offset() == received.size());
                const auto bytes = piece->blocks[0].bytes;
                received.append(reinterpret_cast<const char*>(bytes.data()), bytes.size());
                outstanding += frame.header.bulk_bytes;
                CHECK(outstanding <= window);
                if (outstanding > window / 2) {
                    wire::CreditT credit;
                    credit.bytes = std::exchange(outstanding, 0);
                    peer.send(id, credit);
                }
            }
        });
        const auto connection = client::Connection::open(daemon.uri(), "");
        REQUIRE(connection);
        REQUIRE((*connection)->start(wire::LoadT{}));
        wire::NeedT need;
        need.files = {1, 2};
        const auto frame = protocol::encode(1, need);
        client::Progress progress(client::Progress::Style::none);
        CHECK(client::send_files(**connection, *upload,
                                 *protocol::open<wire::Need>(*frame).value().table, progress));
    }
    CHECK(received == large);
}

TEST_SUITE_BEGIN("shared scenes");

bool have_shared_scenes() {
    if (std::filesystem::exists(RAYNEST_SHARED_SCENES)) return true;
    MESSAGE("skipped: no shared scenes at " RAYNEST_SHARED_SCENES);
    return false;
}

TEST_CASE("the shared hostile files are refused or left to the daemon, quickly") {
    if (!have_shared_scenes()) return;
    const std::filesystem::path hostile = std::string(RAYNEST_SHARED_SCENES) + "/hostile";
    // The files that they name must not be sent along.
    std::size_t outside = 0;
    const std::set<std::string> stems = {"buf_uri", "img_uri"};
    for (const auto& entry : std::filesystem::directory_iterator(hostile)) {
        const std::string name = entry.path().filename().string();
        if (!name.ends_with(".gltf") && !name.ends_with(".glb")) continue;
        CAPTURE(name);
        const std::clock_t start = std::clock();
        const auto upload = gather(entry.path().string(), "", "");
        CHECK(std::clock() - start < 5 * CLOCKS_PER_SEC);
        if (!upload) CHECK(upload.error().exit == protocol::Exit::invalid);
        if (!stems.contains(name.substr(0, 7))) continue;
        ++outside;
        CHECK((!upload || upload->files.size() == 1));
    }
    CHECK(outside >= 15);
}

TEST_CASE("a good scene cut anywhere is refused by the client or left to the daemon") {
    if (!have_shared_scenes()) return;
    const std::filesystem::path whole =
        std::string(RAYNEST_SHARED_SCENES) + "/small/simple-instancing.glb";
    const auto read = client::read_file(whole.string(), 1U << 20);
    REQUIRE(read);
    const std::string bytes(reinterpret_cast<const char*>(read->data()), read->size());
    const TemporaryFolder folder;
    for (std::size_t i = 0; i < 200; ++i) {
        folder.write("cut.glb", bytes.substr(0, bytes.size() * i / 200));
        CHECK(!gather(folder.file("cut.glb"), "", ""));
    }
}

TEST_SUITE_END();

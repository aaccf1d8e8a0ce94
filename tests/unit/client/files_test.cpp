#include "client/files/files.h"

#include "client/output/output_file.h"
#include "tests/temporary_folder.h"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <string>
#include <thread>

using namespace raynest;
using test::TemporaryFolder;

namespace {

std::string text_of(const protocol::Buffer& buffer) {
    return {reinterpret_cast<const char*>(buffer.data()), buffer.size()};
}

}  // namespace

TEST_CASE("a file beneath the folder is read, whatever its depth") {
    const TemporaryFolder folder;
    folder.write("a.bin", "one");
    folder.write("deep/er/b.bin", "two");
    CHECK(text_of(**client::read_file_beneath(folder.path(), "a.bin", 100)) == "one");
    CHECK(text_of(**client::read_file_beneath(folder.path(), "deep/er/b.bin", 100)) == "two");
}

TEST_CASE("nothing outside of the folder is read") {
    const TemporaryFolder outside;
    outside.write("secret", "secret");
    const TemporaryFolder folder;
    std::filesystem::create_symlink(outside.file("secret"), folder.file("link"));
    std::filesystem::create_directory_symlink(outside.path(), folder.file("dir"));
    const std::string up = "../" + std::filesystem::path(outside.path()).filename().string();
    for (const std::string& name :
         {std::string("link"), std::string("dir/secret"), up + "/secret", outside.file("secret"),
          std::string(""), std::string("."), std::string(".."), std::string("dir/../dir/secret"),
          std::string("missing"), std::string("secret\0x", 8)}) {
        CAPTURE(name);
        const auto read = client::read_file_beneath(folder.path(), name, 100);
        CHECK((!read || !*read));
        if (!read) CHECK(read.error().exit == protocol::Exit::invalid);
    }
    CHECK(client::read_file_beneath(folder.path(), "link", 100)
              .error()
              .message.find("link leaves the folder") != std::string::npos);
}

TEST_CASE("links are followed where they end in the folder") {
    const TemporaryFolder folder;
    folder.write("deep/er/b.bin", "two");
    std::filesystem::create_symlink("deep/er/b.bin", folder.file("file"));
    std::filesystem::create_symlink("../deep/./er/../er/b.bin", folder.file("deep/again"));
    std::filesystem::create_directory_symlink("deep", folder.file("dir"));
    std::filesystem::create_symlink(
        "../" + std::filesystem::path(folder.path()).filename().string() + "/deep/er/b.bin",
        folder.file("out_and_in"));
    std::filesystem::create_symlink(folder.file("deep/er/b.bin"), folder.file("absolute"));
    std::filesystem::create_directory_symlink(folder.file("deep/er"), folder.file("absolute_dir"));
    for (const char* name : {"file", "deep/again", "dir/er/b.bin", "dir/again", "out_and_in",
                             "absolute", "absolute_dir/b.bin"}) {
        CAPTURE(name);
        const auto read = client::read_file_beneath(folder.path(), name, 100);
        REQUIRE((read && *read));
        CHECK(text_of(**read) == "two");
    }
    std::filesystem::create_symlink("round", folder.file("around"));
    std::filesystem::create_symlink("around", folder.file("round"));
    std::filesystem::create_symlink("/dev/zero", folder.file("zero"));
    for (const char* name : {"round", "zero", "round/b.bin"}) {
        CAPTURE(name);
        CHECK(!client::read_file_beneath(folder.path(), name, 100));
    }
}

TEST_CASE("beneath a folder only regular files are read, and pipes are not waited for") {
    const TemporaryFolder folder;
    REQUIRE(::mkfifo(folder.file("pipe").c_str(), 0600) == 0);
    std::filesystem::create_directory(folder.file("sub"));
    CHECK(!client::read_file_beneath(folder.path(), "pipe", 100));
    CHECK(!client::read_file_beneath(folder.path(), "sub", 100));
}

TEST_CASE("a pipe that the user names is read to its end, which must come") {
    const TemporaryFolder folder;
    const std::string pipe = folder.file("pipe");
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    const std::string text(200'000, 'x');
    std::thread writer([&] { std::ofstream(pipe) << text; });
    const auto read = client::read_file(pipe, 1 << 20);
    writer.join();
    REQUIRE(read);
    CHECK(text_of(*read) == text);

    for (const std::string& bad : {std::string("/dev/zero"), std::string(folder.path())}) {
        const auto refused = client::read_file(bad, 1 << 20);
        REQUIRE(!refused);
        CHECK(refused.error().exit == protocol::Exit::invalid);
    }
    CHECK(client::read_file("/dev/null", 100).value().size() == 0);
}

TEST_CASE("an ending has small letters") {
    CHECK(client::extension_of("a/b.PNG") == ".png");
    CHECK(client::extension_of("b.tar.gz") == ".gz");
    CHECK(client::extension_of("a.b/c").empty());
    CHECK(client::extension_of("c").empty());
}

TEST_CASE("a file over the limit is refused by its size") {
    const TemporaryFolder folder;
    folder.write("a", "12345");
    CHECK(client::read_file(folder.file("a"), 5));
    CHECK(!client::read_file(folder.file("a"), 4));
}

TEST_CASE("a file is written whole or not at all") {
    const TemporaryFolder folder;
    folder.write("out", "old");
    const std::string text = "new";
    REQUIRE(client::write_file(folder.file("out"), std::as_bytes(std::span(text))));
    CHECK(text_of(client::read_file(folder.file("out"), 100).value()) == "new");
    std::filesystem::create_directory(folder.file("taken"));
    CHECK(!client::write_file(folder.file("taken"), std::as_bytes(std::span(text))));
    CHECK(!client::write_file(folder.file("no/such/folder"), std::as_bytes(std::span(text))));
    std::set<std::string> left;
    for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
        left.insert(entry.path().filename());
    CHECK(left == std::set<std::string>{"out", "taken"});
}

TEST_CASE("a link stays a link, and a pipe a pipe") {
    const TemporaryFolder folder;
    folder.write("far", "old");
    const std::string link = folder.file("link");
    std::filesystem::create_symlink("far", link);
    const std::string text = "new";
    const auto bytes = std::as_bytes(std::span(text));
    REQUIRE(client::check_writable(link));
    REQUIRE(client::write_file(link, bytes));
    CHECK(std::filesystem::is_symlink(link));
    CHECK(text_of(client::read_file(folder.file("far"), 100).value()) == "new");

    const std::string pipe = folder.file("pipe");
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    const int reader = ::open(pipe.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    REQUIRE(reader >= 0);
    REQUIRE(client::check_writable(pipe));
    REQUIRE(client::write_file(pipe, bytes));
    char read[8] = {};
    CHECK(::read(reader, read, sizeof read) == 3);
    CHECK(std::string(read) == "new");
    ::close(reader);
    CHECK(std::filesystem::is_fifo(pipe));
}

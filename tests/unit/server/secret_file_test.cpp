// Files of an administrator: who may read them, and where links lead.
#include "server/security/secret_file.h"

#include "tests/temporary_folder.h"
#include "tests/unit/server/file_place.h"

#include <doctest/doctest.h>
#include <grp.h>
#include <sys/stat.h>
#include <sys/xattr.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

std::string content_of(const std::filesystem::path& file) {
    return read_regular_file(file, 100, "").value();
}

TEST_CASE("root's file may be read by a group of this process, but by no group of everybody's" *
          doctest::skip(geteuid() != 0)) {
    const test::TemporaryFolder folder;
    const std::filesystem::path file = folder.path() / "key";
    REQUIRE(write_files_atomically({{place_of(file), "secret"}}));
    const auto reads = [&](gid_t group, mode_t mode, Reader reader) {
        REQUIRE(chown(file.c_str(), 0, group) == 0);
        REQUIRE(chmod(file.c_str(), mode) == 0);
        return read_secret_file(file, 100, reader).has_value();
    };
    constexpr gid_t strange = 54321;
    constexpr gid_t nogroup = 65534;
    for (const Reader reader : {Reader::daemon, Reader::command}) CHECK(reads(0, 0640, reader));
    CHECK(reads(strange, 0640, Reader::command));
    CHECK_FALSE(reads(strange, 0640, Reader::daemon));
    CHECK(reads(strange, 0600, Reader::daemon));
    std::vector<gid_t> before(static_cast<std::size_t>(getgroups(0, nullptr)));
    REQUIRE(getgroups(static_cast<int>(before.size()), before.data()) >= 0);
    const std::array<gid_t, 2> groups = {strange, nogroup};
    REQUIRE(setgroups(groups.size(), groups.data()) == 0);
    CHECK(reads(strange, 0640, Reader::daemon));
    CHECK(reads(strange, 0440, Reader::daemon));
    CHECK_FALSE(reads(strange, 0660, Reader::daemon));
    CHECK_FALSE(reads(strange, 0640, Reader::signer));
    if (getgrgid(nogroup) != nullptr) CHECK_FALSE(reads(nogroup, 0640, Reader::daemon));
    REQUIRE(chown(file.c_str(), 12345, strange) == 0);
    CHECK_FALSE(read_secret_file(file, 100, Reader::daemon));
    CHECK(setgroups(before.size(), before.data()) == 0);
}

/// Returns why others could change a file; the check of packs and a read agree.
std::string fault_of(const std::filesystem::path& file) {
    const std::string why = place_fault(file, "do harm");
    const auto read = read_regular_file(file, 100, "do harm");
    CHECK(why.empty() == read.has_value());
    if (!read) CHECK(read.error().message == file.string() + ": " + why);
    CHECK((why.empty() || why.find(" do harm; ") != std::string::npos));
    return why;
}

/// An access list by which the user 12345 may write.
bool add_access_list(const std::filesystem::path& file) {
    constexpr std::array<std::uint32_t, 11> list = {2,   0x60001, ~0U, 0x60002, 12345, 0x40004,
                                                    ~0U, 0x60010, ~0U, 0x40020, ~0U};
    return setxattr(file.c_str(), "system.posix_acl_access", list.data(), sizeof list, 0) == 0;
}

TEST_CASE("who may change a file, or put another one in its place, is asked by one rule") {
    const test::TemporaryFolder outer;
    const std::filesystem::path folder = outer.path() / "folder";
    const std::filesystem::path file = folder / "file";
    const std::filesystem::path link = outer.path() / "link";
    REQUIRE(std::filesystem::create_directory(folder));
    REQUIRE(write_files_atomically({{place_of(file), "content"}}));
    std::filesystem::create_symlink("folder/file", link);
    const auto is_good = [&](mode_t folder_mode, mode_t mode) {
        REQUIRE(chmod(folder.c_str(), folder_mode) == 0);
        REQUIRE(chmod(file.c_str(), mode) == 0);
        const std::string why = fault_of(file);
        CHECK(why.empty() == fault_of(link).empty());
        return why.empty();
    };
    CHECK(is_good(0755, 0644));
    CHECK(is_good(0755, 0400));
    CHECK_FALSE(is_good(0755, 0646));
    CHECK_FALSE(is_good(0757, 0644));
    CHECK(is_good(01777, 0644));
    CHECK_FALSE(place_fault(folder, "do harm").empty());
    CHECK(others_fault(folder / "none", "do harm").empty());
    // A folder further up.
    REQUIRE(chmod(outer.path().c_str(), 0777) == 0);
    CHECK_FALSE(is_good(0755, 0644));
    REQUIRE(chmod(outer.path().c_str(), 0755) == 0);
    if (geteuid() != 0) return;
    constexpr uid_t other = 12345;
    REQUIRE(chown(file.c_str(), 0, other) == 0);
    CHECK_FALSE(is_good(0755, 0664));
    CHECK(is_good(0755, 0644));
    REQUIRE(chown(file.c_str(), other, 0) == 0);
    CHECK_FALSE(is_good(0755, 0644));
    CHECK_FALSE(is_good(01777, 0644));
    REQUIRE(chown(file.c_str(), 0, 0) == 0);
    REQUIRE(chown(folder.c_str(), other, 0) == 0);
    CHECK_FALSE(is_good(0755, 0644));
    CHECK_FALSE(is_good(01777, 0644));
    REQUIRE(chown(folder.c_str(), 0, 0) == 0);
    // A link of another user, and one of root in another user's folder.
    CHECK(is_good(0755, 0644));
    REQUIRE(lchown(link.c_str(), other, 0) == 0);
    CHECK(fault_of(file).empty());
    CHECK_FALSE(fault_of(link).empty());
    REQUIRE(lchown(link.c_str(), 0, 0) == 0);
    const std::filesystem::path theirs = outer.path() / "theirs";
    REQUIRE(std::filesystem::create_directory(theirs));
    std::filesystem::create_symlink("../link", theirs / "hop");
    std::filesystem::create_symlink("theirs/hop", outer.path() / "first");
    CHECK(fault_of(outer.path() / "first").empty());
    REQUIRE(chown(theirs.c_str(), other, 0) == 0);
    CHECK_FALSE(fault_of(outer.path() / "first").empty());
}

TEST_CASE("a group may write if nobody else is in it, and no access list names others" *
          doctest::skip(geteuid() != 0)) {
    const test::TemporaryFolder outer;
    const std::filesystem::path folder = outer.path() / "folder";
    const std::filesystem::path file = folder / "file";
    REQUIRE(std::filesystem::create_directory(folder));
    REQUIRE(write_files_atomically({{place_of(file), "content"}}));
    const auto give = [&](gid_t group) {
        for (const auto& part : {folder, file}) {
            REQUIRE(chown(part.c_str(), 0, group) == 0);
            REQUIRE(chmod(part.c_str(), part == folder ? 0775 : 0664) == 0);
        }
    };
    constexpr gid_t own = 54321;
    constexpr gid_t nogroup = 65534;
    const gid_t before = getegid();
    REQUIRE(setegid(own) == 0);
    give(own);
    CHECK(fault_of(file).empty());
    for (const auto& part : {folder, file}) {
        if (!add_access_list(part)) continue;
        CHECK(fault_of(file).ends_with("; setfacl -b " + part.string()));
        REQUIRE(removexattr(part.c_str(), "system.posix_acl_access") == 0);
    }
    give(own + 1);
    CHECK(fault_of(file).ends_with("; chmod g-w " + folder.string()));
    REQUIRE(setegid(nogroup) == 0);
    give(nogroup);
    if (getgrgid(nogroup) != nullptr) CHECK_FALSE(fault_of(file).empty());
    CHECK(setegid(before) == 0);
}

TEST_CASE("a replaced file keeps its mode, and a link leads to its target") {
    const test::TemporaryFolder folder;
    const std::filesystem::path file = folder.path() / "target";
    const std::filesystem::path link = folder.path() / "link";
    REQUIRE(write_files_atomically({{place_of(file), "old"}}));
    REQUIRE(chmod(file.c_str(), 0640) == 0);
    std::filesystem::create_symlink("target", link);
    REQUIRE(write_files_atomically({{place_of(link), "new"}}));
    CHECK(std::filesystem::is_symlink(link));
    CHECK(content_of(file) == "new");
    struct stat status {};
    REQUIRE(stat(file.c_str(), &status) == 0);
    CHECK((status.st_mode & 07777U) == 0640);
    CHECK(place_of(link).path() == file);
    CHECK(place_of(file).path() == file);
    CHECK_FALSE(place_of(folder.path() / "none").exists());
    REQUIRE(unlink(file.c_str()) == 0);
    CHECK_FALSE(FilePlace::find(link));
    CHECK_FALSE(FilePlace::find(folder.path() / "none" / "file"));
    CHECK_FALSE(FilePlace::find(folder.path() / ""));
    std::filesystem::create_symlink("link", file);
    CHECK_FALSE(FilePlace::find(link));
}

TEST_CASE("links and folders that change after a place was found lead nobody elsewhere") {
    const test::TemporaryFolder folder;
    folder.write("good/file", "good");
    folder.write("bad/file", "bad");
    std::filesystem::create_symlink("good", folder.path() / "folder");
    std::filesystem::create_symlink("folder/file", folder.path() / "link");
    const FilePlace place = place_of(folder.path() / "link");
    std::filesystem::remove(folder.path() / "link");
    std::filesystem::create_symlink("bad/file", folder.path() / "link");
    std::filesystem::remove(folder.path() / "folder");
    std::filesystem::create_symlink("bad", folder.path() / "folder");
    CHECK(*read_regular_file(place, 100) == "good");
    REQUIRE(write_files_atomically({{place, "better"}}));
    CHECK(content_of(folder.path() / "good" / "file") == "better");
    CHECK(content_of(folder.path() / "bad" / "file") == "bad");
    // A link in the file's own place is not followed, but replaced.
    std::filesystem::remove(folder.path() / "good" / "file");
    std::filesystem::create_symlink("../bad/file", folder.path() / "good" / "file");
    CHECK_FALSE(read_regular_file(place, 100));
    REQUIRE(write_files_atomically({{place, "best"}}));
    CHECK(content_of(folder.path() / "bad" / "file") == "bad");
    CHECK_FALSE(write_files_atomically({{place, "first", true}}));
    CHECK(*read_regular_file(place, 100) == "best");
}

TEST_CASE("files are written all or none, and no temporary ones stay") {
    const test::TemporaryFolder folder;
    const std::filesystem::path gone = folder.path() / "none";
    std::filesystem::create_directory(gone);
    const FilePlace second = place_of(gone / "second");
    std::filesystem::remove(gone);
    CHECK_FALSE(write_files_atomically({{place_of(folder.path() / "first"), "1"}, {second, "2"}}));
    CHECK(std::filesystem::is_empty(folder.path()));
}

}  // namespace
}  // namespace raynest::server

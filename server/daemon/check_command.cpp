#include "server/daemon/check_command.h"

#include "protocol/text.h"
#include "server/options/ready_file.h"
#include "server/store/backup.h"
#include "server/store/manifest.h"
#include "server/store/state_folder.h"

#include <algorithm>
#include <csignal>
#include <cstdint>
#include <iostream>
#include <string>
#include <system_error>

namespace raynest::server {
namespace {

/// Most bytes of a printed line.
constexpr std::size_t line_bytes_max = 4096;

int failed(const std::string& why) {
    std::cerr << "raynestd: " << protocol::clean_text(why, line_bytes_max) << '\n';
    return 1;
}

int refuse_if_no_state(const std::filesystem::path& folder) {
    std::error_code error;
    if (std::filesystem::exists(folder / "manifest.sqlite", error)) return 0;
    return failed(folder.string() + " is no state folder: it has no manifest.sqlite");
}

struct Files {
    std::uint64_t count = 0;
    std::uint64_t bytes = 0;
};
Files files_in(const std::filesystem::path& folder) {
    Files found;
    std::error_code error;
    for (const auto& file : std::filesystem::directory_iterator(folder, error)) {
        const std::uint64_t bytes = file.file_size(error);
        if (error) continue;
        ++found.count;
        found.bytes += bytes;
    }
    return found;
}

}  // namespace

int check_state(const std::filesystem::path& folder) {
    if (const int none = refuse_if_no_state(folder); none != 0) return none;
    const auto lock = StateLock::take(folder);
    if (!lock) return failed(lock.error().message);
    auto manifest = Manifest::open(folder / "manifest.sqlite", true);
    if (!manifest) return failed(manifest.error().message);
    const auto rows = manifest->rows();
    if (!rows) return failed(rows.error().message);
    std::size_t damaged = 0;
    std::uint64_t bytes = 0;
    for (const StoredScene& row : *rows) {
        bytes += row.bytes;
        const auto stored = read_stored(folder, row.digest, row.bytes);
        const auto edits = manifest->edits(row.number);
        if (stored && edits) continue;
        ++damaged;
        const std::string& why = stored ? edits.error().message : stored.error().why;
        std::cout << protocol::clean_text(
                         row.owner + "/" + row.name + ": " + why + "; load it again",
                         line_bytes_max)
                  << '\n';
    }
    std::cout << rows->size() << " scenes, " << protocol::bytes_text(bytes) << ", " << damaged
              << " damaged\n";
    if (!std::cout.flush()) return failed("cannot write stdout");
    return damaged == 0 ? 0 : 1;
}

int back_up_state(const std::filesystem::path& from, const std::filesystem::path& to) {
    (void)std::signal(SIGXFSZ, SIG_IGN);  // write() says EFBIG
    const auto missing = back_up(from, to);
    if (!missing) return failed(missing.error().message);
    const int checked = check_state(to);
    if (*missing != 0)
        return failed(std::to_string(*missing) + " scenes have lost their blobs in " +
                      from.string() + "; load them again");
    return checked;
}

int restore_state(const std::filesystem::path& backup, const std::filesystem::path& to) {
    namespace fs = std::filesystem;
    if (const int none = refuse_if_no_state(backup); none != 0) return none;
    std::error_code error;
    Result<StateLock> lock;
    if (fs::exists(fs::symlink_status(to, error))) {
        if (!fs::is_directory(fs::symlink_status(to, error)))
            return failed(to.string() + " is no folder; name a new or an empty one");
        for (const auto& entry : fs::directory_iterator(to, error))
            if (entry.path().filename() != "lock")
                return failed(to.string() +
                              " is not empty; move it away, or name a new or an empty folder");
        lock = StateLock::take(to);
        if (!lock) return failed(lock.error().message);
        // A daemon that starts from here on has a folder and a lock of its own: then back_up()
        // fails.
        fs::remove(to / "lock", error);
        if (!fs::remove(to, error))
            return failed("cannot replace " + to.string() + ": " + error.message());
    }
    return back_up_state(backup, to);
}

int collect_state(const std::filesystem::path& folder) {
    if (const int none = refuse_if_no_state(folder); none != 0) return none;
    const auto lock = StateLock::take(folder);
    if (!lock)
        return failed(lock.error().message + "; a running daemon removes such files itself");
    const Files before = files_in(folder / "blobs");
    // What a daemon does at its start.
    const auto opened = StateFolder::open(folder);
    if (!opened) return failed(opened.error().message);
    const Files after = files_in(folder / "blobs"), damaged = files_in(folder / "damaged");
    std::cout << before.count - after.count << " files removed, "
              << protocol::bytes_text(before.bytes - after.bytes) << " freed; " << after.count
              << " blobs, " << protocol::bytes_text(after.bytes) << ", are in use\n";
    if (damaged.count != 0)
        std::cout << damaged.count << " damaged blobs, " << protocol::bytes_text(damaged.bytes)
                  << ", lie in " << protocol::clean_text((folder / "damaged").string(), line_bytes_max)
                  << " for a look: remove them when it is done\n";
    return std::cout.flush() ? 0 : failed("cannot write stdout");
}

}  // namespace raynest::server

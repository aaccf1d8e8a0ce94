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

/// Checks what back_up() or restore() has made. `missing` is their outcome.
int check_copy(const std::filesystem::path& from, const Result<std::uint64_t>& missing,
               const std::filesystem::path& to) {
    if (!missing) return failed(missing.error().message);
    const int checked = check_state(to);
    if (*missing != 0)
        return failed(std::to_string(*missing) + " scenes have lost their blobs in " +
                      from.string() + "; load them again");
    return checked;
}

}  // namespace

int check_state(const std::filesystem::path& folder) {
    const std::filesystem::path manifest_file = folder / "manifest.sqlite";
    std::error_code error;
    if (!std::filesystem::exists(manifest_file, error))
        return failed(folder.string() + " is no state folder: it has no manifest.sqlite");
    const auto lock = StateLock::take(folder);
    if (!lock) return failed(lock.error().message);
    auto manifest = Manifest::open(manifest_file, true);
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
    return check_copy(from, back_up(from, to), to);
}

int restore_state(const std::filesystem::path& backup, const std::filesystem::path& folder) {
    (void)std::signal(SIGXFSZ, SIG_IGN);
    Result<std::uint64_t> missing;
    {
        const auto lock = StateLock::take(folder);
        if (!lock) return failed(lock.error().message);
        missing = restore(backup, folder);
    }
    const int code = check_copy(backup, missing, folder);
    std::error_code error;
    if (missing && std::filesystem::exists(folder / "replaced", error))
        std::cout << "before it held what is now in " << (folder / "replaced").string()
                  << "; once all is well, raynestd gc " << folder.string() << " removes that\n";
    return std::cout.flush() ? code : failed("cannot write stdout");
}

int remove_state_garbage(const std::filesystem::path& folder) {
    std::error_code error;
    if (!std::filesystem::exists(folder / "manifest.sqlite", error))
        return failed(folder.string() + " is no state folder: it has no manifest.sqlite");
    const auto lock = StateLock::take(folder);
    if (!lock) return failed(lock.error().message);
    const auto bytes = remove_garbage(folder);
    if (!bytes) return failed(bytes.error().message);
    std::cout << protocol::bytes_text(*bytes) << " removed\n";
    return std::cout.flush() ? 0 : failed("cannot write stdout");
}

}  // namespace raynest::server

#include "server/store/backup.h"

#include "server/ground/log.h"
#include "server/store/file.h"
#include "server/store/manifest.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <set>
#include <span>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

namespace raynest::server {
namespace fs = std::filesystem;
namespace {

constexpr std::size_t step_bytes = 8 << 20;
/// A scene that is replaced or unloaded meanwhile takes its blob along; then the manifest is copied
/// again.
constexpr int tries = 20;

tl::unexpected<Error> refused(const std::string& doing, int error) {
    const bool full = error == ENOSPC || error == EDQUOT || error == EFBIG;
    return fail(ErrorCode::io_failed, doing + ": " + reason(error) +
                                          (full ? "; make room there, or name another disk" : ""));
}

/// True if the blob itself is lost: no other user, and no later try, could read it.
bool is_lost(int error) {
    return error == ENOENT || error == EIO || error == not_a_file;
}

/// Copies and flushes. Returns false if the blob is lost: one damaged scene keeps no other from its
/// backup.
Result<bool> copy_blob(const fs::path& from, const fs::path& to) {
    const File source(from, O_RDONLY);
    if (!source.is_open() && is_lost(errno)) return false;
    if (!source.is_open()) return refused("cannot read " + from.string(), errno);
    const File target(to, O_WRONLY | O_CREAT | O_EXCL, S_IRUSR | S_IWUSR);
    if (!target.is_open()) return refused("cannot make " + to.string(), errno);
    std::vector<char> bytes(step_bytes);
    for (;;) {
        const ssize_t read = ::read(source.number(), bytes.data(), bytes.size());
        if (read < 0 && errno == EINTR) continue;
        if (read < 0 && is_lost(errno)) {
            ::unlink(to.c_str());
            return false;
        }
        if (read < 0) return refused("cannot read " + from.string(), errno);
        if (read == 0) break;
        for (ssize_t at = 0; at < read;) {
            const ssize_t written =
                ::write(target.number(), bytes.data() + at, static_cast<std::size_t>(read - at));
            if (written < 0 && errno == EINTR) continue;
            if (written < 0) return refused("cannot write " + to.string(), errno);
            at += written;
        }
    }
    if (::fsync(target.number()) != 0) return refused("cannot flush " + to.string(), errno);
    return true;
}

Result<void> flush(const fs::path& path, int flags) {
    const File file(path, O_RDONLY | flags);
    if (file.is_open() && ::fsync(file.number()) == 0) return {};
    return refused("cannot flush " + path.string(), errno);
}

/// Copies the manifest, and the blobs of its rows that are not in `to` yet. Leaves the paths of
/// blobs that `from` has no more in `gone`.
Result<std::uint64_t> copy_once(const fs::path& from, const fs::path& to,
                                std::set<std::string>& gone) {
    const fs::path copy = to / "manifest.sqlite";
    std::error_code ignored;
    fs::remove(copy, ignored);
    {
        auto manifest = Manifest::open(from / "manifest.sqlite", true);
        if (!manifest) return tl::unexpected(manifest.error());
        if (const auto copied = manifest->copy_to(copy); !copied)
            return tl::unexpected(copied.error());
    }
    auto manifest = Manifest::open(copy, true);
    if (!manifest) return tl::unexpected(manifest.error());
    const auto rows = manifest->rows();
    if (!rows) return tl::unexpected(rows.error());
    std::uint64_t missing = 0;
    std::set<std::string> used;
    gone.clear();
    for (const StoredScene& row : *rows) {
        if (!used.insert(row.digest).second) continue;
        const fs::path blob = to / "blobs" / row.digest;
        if (fs::exists(blob, ignored)) continue;
        const auto copied = copy_blob(from / "blobs" / row.digest, blob);
        if (!copied) return tl::unexpected(copied.error());
        if (!*copied) gone.insert(row.digest);
    }
    for (const StoredScene& row : *rows) missing += gone.contains(row.digest) ? 1U : 0U;
    for (const auto& file : fs::directory_iterator(to / "blobs", ignored))
        if (!used.contains(file.path().filename().string())) fs::remove(file.path(), ignored);
    if (const auto done = flush(copy, 0); !done) return tl::unexpected(done.error());
    return missing;
}

Result<std::uint64_t> fill(const fs::path& from, const fs::path& to) {
    for (const fs::path& part : {to / "blobs", to / "damaged"})
        if (::mkdir(part.c_str(), S_IRWXU) != 0)
            return refused("cannot make " + part.string(), errno);
    std::set<std::string> gone;
    std::set<std::string> gone_before;
    Result<std::uint64_t> missing;
    for (int i = 0; i < tries; ++i) {
        missing = copy_once(from, to, gone);
        // One that is gone twice is no blob of a scene that was just replaced: it is lost.
        if (!missing || gone.empty() || gone == gone_before) break;
        gone_before = std::exchange(gone, {});
    }
    if (!missing) return missing;
    if (const auto done = flush(to / "blobs", O_DIRECTORY); !done)
        return tl::unexpected(done.error());
    if (const auto done = flush(to, O_DIRECTORY); !done) return tl::unexpected(done.error());
    return missing;
}

/// The parts of a state folder, in two orders: the manifest leaves first and comes last, for without
/// it nothing else counts.
constexpr std::array moves_out = {"manifest.sqlite", "manifest.sqlite-wal", "manifest.sqlite-shm",
                                  "damaged", "blobs"};
constexpr std::array moves_in = {"blobs", "damaged", "manifest.sqlite-shm", "manifest.sqlite-wal",
                                 "manifest.sqlite"};

Result<void> move_parts(const fs::path& from, const fs::path& to,
                        std::span<const char* const> parts) {
    std::error_code error;
    for (const char* part : parts) {
        if (!fs::exists(fs::symlink_status(from / part, error))) continue;
        if (::rename((from / part).c_str(), (to / part).c_str()) != 0)
            return refused("cannot move " + (from / part).string(), errno);
    }
    return {};
}

/// The name of an open folder.
fs::path opened(const File& folder) {
    return "/proc/self/fd/" + std::to_string(folder.number());
}

/// The bytes of the files at and below a path; 0 for a link.
std::uint64_t bytes_below(const fs::path& path) {
    std::error_code error;
    std::uint64_t bytes = 0;
    const auto add = [&](const fs::directory_entry& file) {
        if (file.is_regular_file(error) && !file.is_symlink(error)) bytes += file.file_size(error);
    };
    const fs::directory_entry top(path, error);
    if (top.is_symlink(error)) return 0;
    add(top);
    for (const auto& file : fs::recursive_directory_iterator(path, error)) add(file);
    return bytes;
}

/// Opens a folder of the state. A link in its place leads to what is somebody else's; through its
/// descriptor a folder stays the one that was opened.
File folder_of_files(const fs::path& folder) {
    return File(folder, O_RDONLY | O_DIRECTORY | O_NOFOLLOW);
}

std::vector<fs::path> files_in(const File& folder) {
    std::error_code error;
    std::vector<fs::path> files;
    if (!folder.is_open()) return files;
    for (const auto& file : fs::directory_iterator(opened(folder), error))
        files.push_back(file.path());
    return files;
}

/// Removes files and folders; returns their bytes.
Result<std::uint64_t> remove_all(const std::vector<fs::path>& garbage) {
    std::uint64_t bytes = 0;
    for (const fs::path& path : garbage) {
        const std::uint64_t here = bytes_below(path);
        std::error_code error;
        fs::remove_all(path, error);
        if (error)
            return fail(ErrorCode::io_failed,
                        "cannot remove " + path.string() + ": " + error.message());
        bytes += here;
    }
    return bytes;
}

/// Refuses two folders that are one, or of which one lies within the other: gc and restore take away
/// what is not the state's own.
Result<void> check_apart(const fs::path& state, const fs::path& backup) {
    const auto resolved = [](const fs::path& path) {
        std::error_code error;
        fs::path made = fs::weakly_canonical(path, error);
        if (error) made = fs::absolute(path, error).lexically_normal();
        return made.has_filename() ? made : made.parent_path();
    };
    const auto is_within = [](const fs::path& inner, const fs::path& outer) {
        return std::mismatch(outer.begin(), outer.end(), inner.begin(), inner.end()).first ==
               outer.end();
    };
    const fs::path here = resolved(state), there = resolved(backup);
    if (!is_within(here, there) && !is_within(there, here)) return {};
    return fail(ErrorCode::io_failed, "the backup " + backup.string() + " and the state folder " +
                                          state.string() +
                                          " lie within each other; name a folder beside it");
}

Result<std::uint64_t> copy_state(const fs::path& from, const fs::path& to) {
    std::error_code error;
    if (!fs::exists(from / "manifest.sqlite", error) ||
        fs::file_size(from / "manifest.sqlite", error) == 0)
        return fail(ErrorCode::io_failed,
                    from.string() + " is no state folder: its manifest.sqlite is missing or empty");
    if (fs::exists(fs::symlink_status(to, error)))
        return fail(ErrorCode::io_failed, to.string() + " exists; name a new folder");
    const fs::path name = to.has_filename() ? to : to.parent_path();
    fs::path unfinished = name;
    unfinished += ".unfinished";
    if (::mkdir(unfinished.c_str(), S_IRWXU) != 0) {
        if (errno == EEXIST)
            return fail(ErrorCode::io_failed, unfinished.string() +
                                                  " exists: another backup goes on, or one was "
                                                  "cut off; then remove it");
        return refused("cannot make " + unfinished.string(), errno);
    }
    auto missing = fill(from, unfinished);
    if (missing && ::rename(unfinished.c_str(), name.c_str()) != 0)
        missing = refused("cannot rename " + unfinished.string(), errno);
    const fs::path above = fs::absolute(name, error).parent_path();
    if (missing) {
        if (const auto done = flush(above, O_DIRECTORY); !done) return tl::unexpected(done.error());
        return missing;
    }
    fs::remove_all(unfinished, error);
    return missing;
}

/// Puts a complete copy in the place of what a state folder holds; goes on where another attempt was
/// cut off.
Result<void> put_in_place(const fs::path& folder) {
    const fs::path copy = folder / "restoring";
    const fs::path replaced = folder / "replaced";
    if (::mkdir(replaced.c_str(), S_IRWXU) != 0 && errno != EEXIST)
        return refused("cannot make " + replaced.string(), errno);
    std::error_code error;
    // Its blobs leave the copy first: before that all parts in the folder are old ones.
    if (fs::exists(fs::symlink_status(copy / moves_in.front(), error)))
        if (auto moved = move_parts(folder, replaced, moves_out); !moved) return moved;
    if (auto moved = move_parts(copy, folder, moves_in); !moved) return moved;
    fs::remove_all(copy, error);
    fs::remove(replaced, error);  // if it is empty
    return flush(folder, O_DIRECTORY);
}

}  // namespace

Result<std::uint64_t> back_up(const fs::path& from, const fs::path& to) {
    if (to.empty()) return fail(ErrorCode::io_failed, "the backup needs the name of a new folder");
    if (const auto apart = check_apart(from, to); !apart) return tl::unexpected(apart.error());
    return copy_state(from, to);
}

bool is_half_restored(const fs::path& folder) {
    std::error_code error;
    return fs::is_directory(fs::symlink_status(folder / "restoring", error));
}

Result<void> finish_restore(const fs::path& folder) {
    if (!is_half_restored(folder)) return {};
    log(LogLevel::warn, "restore_finishes", {{"folder", folder.string()}});
    return put_in_place(folder);
}

Result<std::uint64_t> restore(const fs::path& backup, const fs::path& folder) {
    if (const auto apart = check_apart(folder, backup); !apart)
        return tl::unexpected(apart.error());
    const fs::path replaced = folder / "replaced";
    const fs::path copy = folder / "restoring";
    std::error_code error;
    if (const auto done = finish_restore(folder); !done) return tl::unexpected(done.error());
    if (fs::exists(fs::symlink_status(replaced, error)))
        return fail(ErrorCode::io_failed,
                    replaced.string() +
                        " holds what an earlier restore has replaced; move it away, "
                        "or remove it with raynestd gc " +
                        folder.string());
    // A copy that was cut off; nobody else is here.
    fs::remove_all(folder / "restoring.unfinished", error);
    const auto missing = copy_state(backup, copy);
    if (!missing) return missing;
    if (const auto moved = put_in_place(folder); !moved) {
        if (!fs::exists(fs::symlink_status(copy / moves_in.front(), error)))
            (void)move_parts(folder, copy, moves_out);
        (void)move_parts(replaced, folder, moves_in);
        fs::remove_all(copy, error);
        fs::remove(replaced, error);
        return tl::unexpected(moved.error());
    }
    return missing;
}

Result<std::uint64_t> remove_garbage(const fs::path& folder) {
    // A restore that is only finished here has just replaced something: that stays until next time.
    const bool was_half_restored = is_half_restored(folder);
    if (const auto done = finish_restore(folder); !done) return tl::unexpected(done.error());
    std::set<std::string> used;
    {
        auto manifest = Manifest::open(folder / "manifest.sqlite", true);
        if (!manifest) return tl::unexpected(manifest.error());
        const auto rows = manifest->rows();
        if (!rows) return tl::unexpected(rows.error());
        for (const StoredScene& row : *rows) used.insert(row.digest);
    }
    const File damaged = folder_of_files(folder / "damaged");
    const File blobs = folder_of_files(folder / "blobs");
    std::vector<fs::path> garbage = files_in(damaged);
    for (const fs::path& file : files_in(blobs))
        if (!used.contains(file.filename().string())) garbage.push_back(file);
    for (const char* part : {"restoring", "restoring.unfinished"}) garbage.push_back(folder / part);
    if (!was_half_restored) garbage.push_back(folder / "replaced");
    return remove_all(garbage);
}

Result<std::uint64_t> remove_set_aside(const fs::path& folder) {
    const File damaged = folder_of_files(folder / "damaged");
    std::vector<fs::path> garbage = files_in(damaged);
    garbage.push_back(folder / "replaced");
    return remove_all(garbage);
}

}  // namespace raynest::server

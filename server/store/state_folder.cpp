#include "server/store/state_folder.h"

#include "protocol/text.h"
#include "server/store/backup.h"
#include "server/store/file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <new>
#include <string_view>
#include <system_error>

namespace raynest::server {
namespace fs = std::filesystem;
namespace {

/// Bytes that are written or read between two looks at whether to go on.
constexpr std::size_t write_step_bytes = 8 << 20;

std::string disk_failed(const std::string& why = {}) {
    return "the disk of the state folder has failed" + (why.empty() ? why : " (" + why + ")") +
           ": scenes there can be read, none can be stored. See to the disk, then restart raynestd";
}

Result<void> make_folder(const fs::path& folder) {
    const int error = ::mkdir(folder.c_str(), S_IRWXU) == 0 ? 0 : errno;
    struct stat found {};
    // The files behind a link are not the daemon's to remove.
    if ((error == 0 || error == EEXIST) && ::lstat(folder.c_str(), &found) == 0 &&
        !S_ISDIR(found.st_mode))
        return fail(ErrorCode::io_failed,
                    folder.string() + " is no folder; put a folder there, not a link to one");
    if (error == 0 || error == EEXIST) return {};
    errno = error;
    return fail(ErrorCode::io_failed, "cannot make " + folder.string() + ": " + reason(errno) +
                                          "; name a folder that can be written");
}

/// True if the file has these bytes: one that was damaged is written anew.
bool holds(const fs::path& path, std::span<const std::byte> bytes) {
    const File file(path, O_RDONLY);
    struct stat found {};
    if (!file.is_open() || ::fstat(file.number(), &found) != 0 ||
        static_cast<std::uint64_t>(found.st_size) != bytes.size())
        return false;
    std::vector<std::byte> read(std::min<std::size_t>(bytes.size(), 1 << 20));
    while (!bytes.empty()) {
        const ssize_t done =
            ::read(file.number(), read.data(), std::min(read.size(), bytes.size()));
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0 ||
            std::memcmp(read.data(), bytes.data(), static_cast<std::size_t>(done)) != 0)
            return false;
        bytes = bytes.subspan(static_cast<std::size_t>(done));
    }
    return true;
}

}  // namespace

const char* network_file_system(std::uint64_t magic) {
    struct Row {
        std::uint64_t magic;
        const char* name;
    };
    static constexpr std::array rows = {
        Row{0x6969, "NFS"},        Row{0x517B, "SMB"},      Row{0xFF534D42, "CIFS"},
        Row{0xFE534D42, "SMB2"},   Row{0x65735546, "FUSE"}, Row{0x01021997, "9P"},
        Row{0x73757245, "Coda"},   Row{0x5346414F, "AFS"},  Row{0x00C36400, "Ceph"},
        Row{0x7461636F, "OCFS2"},  Row{0x01161970, "GFS2"}, Row{0x0BD00BD0, "Lustre"},
        Row{0x786F4256, "vboxsf"}, Row{0x47504653, "GPFS"},
    };
    const auto* found = std::ranges::find(rows, magic, &Row::magic);
    return found == rows.end() ? nullptr : found->name;
}

Result<std::unique_ptr<StateFolder>> StateFolder::open(const fs::path& folder,
                                                       Leftovers leftovers) {
    if (folder.empty()) return std::unique_ptr<StateFolder>();
    struct statfs system {};
    if (::statfs(folder.c_str(), &system) != 0)
        return fail(ErrorCode::io_failed, "cannot use " + folder.string() + ": " + reason(errno));
    if (const char* name = network_file_system(static_cast<std::uint32_t>(system.f_type)))
        return fail(ErrorCode::io_failed,
                    folder.string() + " is on " + name +
                        ", where scenes may be lost; give --state a folder on a "
                        "disk of this machine");
    if (const auto done = finish_restore(folder); !done) return tl::unexpected(done.error());
    for (const char* part : {"blobs", "damaged"})
        if (const auto made = make_folder(folder / part); !made)
            return tl::unexpected(made.error());
    // A new manifest in place of a lost one would take the rows of all blobs away.
    const fs::path manifest_file = folder / "manifest.sqlite";
    std::error_code error;
    if ((!fs::exists(manifest_file, error) || fs::file_size(manifest_file, error) == 0) &&
        std::ranges::any_of(fs::directory_iterator(folder / "blobs", error), [](const auto& file) {
            return !file.path().filename().string().starts_with('.');
        }))
        return fail(
            ErrorCode::io_failed,
            "the manifest " + manifest_file.string() +
                " is damaged: it is gone or empty, and there are scenes; nothing was changed. "
                "Bring a backup back (raynestd restore BACKUP DIR), or remove the folder blobs");
    auto manifest = Manifest::open(manifest_file);
    if (!manifest) return tl::unexpected(manifest.error());
    auto rows = manifest->rows();
    if (!rows) return tl::unexpected(rows.error());
    std::unique_ptr<StateFolder> state(new StateFolder(folder, std::move(*manifest)));
    for (const StoredScene& row : *rows) {
        state->rows_[{row.owner, row.name}] = {row.digest, row.number};
        state->last_number_ = std::max(state->last_number_.load(), row.number);
    }
    state->found_ = std::move(*rows);
    if (const auto gone = state->manifest_->remove_orphans(); !gone)
        return tl::unexpected(gone.error());
    for (const StoredScene& row : state->found_) {
        auto edits = state->manifest_->sum_of_edits(row.number);
        if (!edits) return tl::unexpected(edits.error());
        state->found_edits_.push_back(std::move(*edits));
    }
    auto uses = state->manifest_->uses();
    if (!uses) return tl::unexpected(uses.error());
    for (const SceneUse& use : *uses) state->found_uses_[use.number] = use;
    if (leftovers == Leftovers::remove) state->remove_leftovers();
    if (!flush_folder(folder) || !flush_folder(folder / "blobs"))
        return fail(ErrorCode::io_failed,
                    "cannot flush " + folder.string() + ": " + reason(errno) + "; see to its disk");
    return state;
}

void StateFolder::remove_leftovers() {
    const std::lock_guard lock(mutex_);
    // A daemon that was killed leaves unfinished files, and blobs whose row was not committed.
    std::set<std::string> used;
    for (const auto& [name, row] : rows_) used.insert(row.digest);
    const std::string own = fmt::format(".new-{}-", ::getpid());
    std::error_code error;
    for (const auto& file : fs::directory_iterator(folder_ / "blobs", error)) {
        const std::string name = file.path().filename();
        if (is_digest(name) && !used.contains(name))
            let_go(name);  // it may be pinned
        else if (!is_digest(name) && (last_temporary_ == 0 || !name.starts_with(own)))
            ::unlink(blob(name).c_str());
    }
    collect_locked();
}

void StateFolder::close() {
    const std::lock_guard lock(mutex_);
    if (closed_) return;
    commit_locked();
    collect_locked();
    closed_ = true;
    manifest_.reset();
}

Result<void> StateFolder::reopen() {
    const std::lock_guard lock(mutex_);
    if (!closed_) return {};
    auto manifest = Manifest::open(folder_ / "manifest.sqlite");
    if (!manifest) return tl::unexpected(manifest.error());
    const auto rows = manifest->rows();
    if (!rows) return tl::unexpected(rows.error());
    const bool is_same =
        rows->size() == rows_.size() && std::ranges::all_of(*rows, [&](const StoredScene& row) {
            const auto known = rows_.find({row.owner, row.name});
            return known != rows_.end() && known->second.number == row.number;
        });
    if (!is_same)
        return fail(ErrorCode::io_failed,
                    "another daemon has changed " + folder_.string() + "; restart raynestd");
    manifest_ = std::move(*manifest);
    closed_ = false;
    return {};
}

fs::path StateFolder::new_path() {
    // The daemon before this one may still write its own.
    return folder_ / "blobs" / fmt::format(".new-{}-{}", ::getpid(), ++last_temporary_);
}

tl::unexpected<Error> StateFolder::flush_failed(int error) {
    // The system forgets a failed flush: the next one would succeed without the bytes. Whatever the
    // reason is, making room mends nothing.
    failed_ = true;
    return fail(ErrorCode::io_failed, disk_failed(reason(error)));
}

Result<void> StateFolder::usable() const {
    if (closed_)
        return fail(ErrorCode::io_failed,
                    "another raynestd has taken the state folder over: connect again");
    if (!failed_ && !manifest_->failed()) return {};
    return fail(ErrorCode::io_failed, disk_failed());
}

Result<void> StateFolder::timed(const std::function<Result<void>()>& commit) {
    const auto begun = std::chrono::steady_clock::now();
    auto done = commit();
    commits_.add(std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count());
    if (manifest_->failed()) failed_ = true;
    return done;
}

BlobPin StateFolder::pin(const std::string& digest) {
    // Made before the lock is taken: its end takes that, too, also its end for want of memory.
    // And `live` keeps what the end needs until the next collect(), so that it may not keep the
    // pins.
    BlobPin pin(new std::string(digest), [known = std::weak_ptr(pins_)](const std::string* ended) {
        const std::unique_ptr<const std::string> owned(ended);
        const std::shared_ptr<Pins> pins = known.lock();
        if (pins == nullptr) return;
        const std::lock_guard guard(pins->mutex);
        try {
            pins->ended.insert(*ended);
        } catch (const std::bad_alloc&) {
            // The next start removes it.
        }
    });
    const std::lock_guard lock(pins_->mutex);
    auto& live = pins_->live[digest];
    if (auto known = live.lock()) return known;
    live = pin;
    return pin;
}

Result<BlobPin> StateFolder::keep(const std::string& digest, std::span<const std::byte> arena,
                                  const Stopped& stopped) {
    {
        const std::lock_guard lock(mutex_);
        if (const auto good = usable(); !good) return tl::unexpected(good.error());
    }
    // First: from then on nobody removes it.
    BlobPin pin = this->pin(digest);
    if (holds(blob(digest), arena)) return pin;
    if (const auto written = write_blob(digest, arena, stopped); !written)
        return tl::unexpected(written.error());
    return pin;
}

Result<void> StateFolder::write_blob(const std::string& digest, std::span<const std::byte> arena,
                                     const Stopped& stopped) {
    const fs::path folder = folder_ / "blobs";
    const fs::path temporary = new_path();
    const auto refused = [&](int error) {
        ::unlink(temporary.c_str());
        const bool full = error == ENOSPC || error == EDQUOT || error == EFBIG;
        return fail(
            ErrorCode::io_failed,
            full ? fmt::format("the state folder has no room for the scene's {}; make room on "
                               "its disk, or unload scenes",
                               protocol::bytes_text(arena.size()))
                 : "the scene could not be stored in the state folder: " + reason(error) +
                       "; see to its disk");
    };
    {
        const File file(temporary, O_WRONLY | O_CREAT | O_EXCL, S_IRUSR | S_IWUSR);
        if (!file.is_open()) return refused(errno);
        // Find out now whether the disk has room.
        const int room = ::posix_fallocate(file.number(), 0, static_cast<off_t>(arena.size()));
        if (room != 0 && room != EOPNOTSUPP && room != EINVAL) return refused(room);
        for (std::span<const std::byte> rest = arena; !rest.empty();) {
            if (stopped()) return refused(ECANCELED);
            const ssize_t done =
                ::write(file.number(), rest.data(), std::min(rest.size(), write_step_bytes));
            if (done < 0 && errno == EINTR) continue;
            if (done < 0) return refused(errno);
            rest = rest.subspan(static_cast<std::size_t>(done));
        }
        if (::fsync(file.number()) != 0) {
            auto error = flush_failed(errno);
            ::unlink(temporary.c_str());
            return error;
        }
    }
    {
        const std::lock_guard guard(pins_->mutex);
        if (::rename(temporary.c_str(), blob(digest).c_str()) != 0) return refused(errno);
    }
    if (!flush_folder(folder)) return flush_failed(errno);
    return {};
}

void StateFolder::hand_in(std::shared_ptr<Keeping> edit) {
    const std::lock_guard guard(pins_->mutex);
    pins_->keeping.push_back(std::move(edit));
}

Result<void> StateFolder::commit(const std::shared_ptr<Keeping>& edit) {
    const std::lock_guard lock(mutex_);
    commit_locked();
    return *edit->outcome;
}

void StateFolder::commit_locked() {
    std::unique_lock guard(pins_->mutex);
    const auto edits = std::exchange(pins_->keeping, {});
    guard.unlock();
    if (edits.empty()) return;
    Result<void> done = usable();
    if (done)
        done = timed([&] {
            return manifest_->together([&]() -> Result<void> {
                for (const auto& edit : edits) {
                    if (broken_.contains(edit->edit.number)) continue;
                    Result<void> put;
                    if (edit->row) put = put_locked(*edit->row);
                    if (put && edit->row) put = manifest_->remove_edits(edit->ended);
                    if (put) put = manifest_->put(edit->edit);
                    if (!put) return put;
                }
                return {};
            });
        });
    for (const auto& edit : edits) {
        const bool follows_broken = broken_.contains(edit->edit.number);
        edit->outcome = done;
        if (done && follows_broken)
            edit->outcome = fail(ErrorCode::io_failed, "an edit before it could not be kept");
        if (done && !follows_broken && edit->row) {
            enter_locked(*edit->row);
        }
    }
    if (!done)
        for (const auto& edit : edits) broken_.insert(edit->edit.number);
}

Result<void> StateFolder::reserve(std::uint64_t number, std::uint64_t epoch) {
    const std::lock_guard lock(mutex_);
    if (const auto good = usable(); !good) return good;
    commit_locked();
    return timed([&] { return manifest_->put(KeptEdit{.number = number, .epoch = epoch}); });
}

Result<std::vector<KeptEdit>> StateFolder::edits(std::uint64_t number) {
    const std::lock_guard lock(mutex_);
    commit_locked();
    if (manifest_) return manifest_->edits(number);
    auto manifest = Manifest::open(folder_ / "manifest.sqlite", true);
    return manifest ? manifest->edits(number) : tl::unexpected(manifest.error());
}

void StateFolder::forget(std::uint64_t number) {
    const std::lock_guard guard(pins_->mutex);
    pins_->forgotten.push_back(number);
}

Result<void> StateFolder::put(const StoredScene& scene) {
    const std::lock_guard lock(mutex_);
    commit_locked();
    if (const auto good = usable(); !good) return good;
    if (const auto put = timed([&] { return put_locked(scene); }); !put) return put;
    enter_locked(scene);
    collect_locked();
    return {};
}

void StateFolder::enter_locked(const StoredScene& row) {
    const Row before = std::exchange(rows_[{row.owner, row.name}], {row.digest, row.number});
    if (!before.digest.empty()) let_go(before.digest);
}

Result<void> StateFolder::remove(const std::vector<StoredScene>& scenes) {
    const std::lock_guard lock(mutex_);
    commit_locked();
    if (const auto good = usable(); !good) return good;
    for (const StoredScene& scene : scenes) {
        const auto gone = manifest_->together([&] {
            auto done = manifest_->remove(scene.owner, scene.name, scene.number);
            return done ? manifest_->remove_edits(scene.number) : done;
        });
        if (!gone) return gone;
        const auto row = rows_.find({scene.owner, scene.name});
        if (row == rows_.end() || row->second.number > scene.number) continue;
        let_go(row->second.digest);
        rows_.erase(row);
    }
    collect_locked();
    return {};
}

void StateFolder::undo(StoredScene scene, std::unique_ptr<StoredScene> before) {
    const std::lock_guard guard(pins_->mutex);
    pins_->undone.emplace_back(std::move(scene), std::move(before));
}

void StateFolder::note(const std::vector<SceneUse>& uses) {
    const std::lock_guard guard(pins_->mutex);
    pins_->uses.insert(pins_->uses.end(), uses.begin(), uses.end());
}

Result<void> StateFolder::put(const std::vector<SceneUse>& uses) {
    const std::lock_guard lock(mutex_);
    // Uses that were noted before would come after these.
    commit_locked();
    collect_locked();
    if (const auto good = usable(); !good) return good;
    return timed([&] { return manifest_->put(uses); });
}

bool StateFolder::has_work() {
    const std::lock_guard guard(pins_->mutex);
    return !pins_->ended.empty() || !pins_->undone.empty() || !pins_->keeping.empty() ||
           !pins_->forgotten.empty() || !pins_->uses.empty() || !pins_->discarded.empty();
}

void StateFolder::collect() {
    const std::lock_guard lock(mutex_);
    commit_locked();
    collect_locked();
}

void StateFolder::let_go(const std::string& digest) {
    const std::lock_guard guard(pins_->mutex);
    pins_->ended.insert(digest);
}

void StateFolder::collect_locked() {
    if (closed_) return;
    std::unique_lock guard(pins_->mutex);
    auto undone = std::exchange(pins_->undone, {});
    const auto forgotten = std::exchange(pins_->forgotten, {});
    const auto uses = std::exchange(pins_->uses, {});
    std::vector<fs::path> unused = std::exchange(pins_->discarded, {});
    guard.unlock();
    if (!uses.empty() && usable()) (void)manifest_->put(uses);
    // The next start removes those that fail here.
    for (const std::uint64_t number : forgotten) (void)manifest_->remove_edits(number);
    for (auto& [scene, before] : undone) {
        const auto row = rows_.find({scene.owner, scene.name});
        if (row == rows_.end() || row->second.number != scene.number) continue;
        if (before ? !manifest_->put(*before)
                   : !manifest_->remove(scene.owner, scene.name, scene.number))
            continue;
        if (before)
            row->second = {before->digest, before->number};
        else
            rows_.erase(row);
        let_go(scene.digest);
    }
    guard.lock();
    for (const std::string& digest : std::exchange(pins_->ended, {})) {
        const auto live = pins_->live.find(digest);
        if (live != pins_->live.end() && !live->second.expired()) continue;
        if (live != pins_->live.end()) pins_->live.erase(live);
        if (std::ranges::any_of(rows_,
                                [&](const auto& row) { return row.second.digest == digest; }))
            continue;
        // To unlink a large file takes long; a load of this content may write it anew from now on.
        const fs::path old = new_path();
        if (::rename(blob(digest).c_str(), old.c_str()) == 0) unused.push_back(old);
    }
    guard.unlock();
    for (const fs::path& file : unused) ::unlink(file.c_str());
}

void StateFolder::set_aside(const std::string& digest, std::uint64_t inode) {
    if (!is_digest(digest)) return;
    {
        const std::lock_guard guard(pins_->mutex);
        struct stat now {};
        if (::lstat(blob(digest).c_str(), &now) != 0 || now.st_ino != inode) return;
        ::rename(blob(digest).c_str(), (folder_ / "damaged" / digest).c_str());
    }
    (void)flush_folder(folder_ / "blobs");
}

std::shared_ptr<void> StateFolder::lock_name(const std::string& owner, const std::string& name,
                                             const Stopped& stopped) {
    constexpr std::chrono::milliseconds look{20};
    std::unique_lock lock(names_mutex_);
    const std::pair key(owner, name);
    while (names_.contains(key)) {
        if (stopped()) return nullptr;
        name_free_.wait_for(lock, look);
    }
    names_.insert(key);
    // It holds no more than this folder, which outlives all jobs.
    return {static_cast<void*>(this), [this, key](void*) {
                const std::lock_guard guard(names_mutex_);
                names_.erase(key);
                name_free_.notify_all();
            }};
}

}  // namespace raynest::server

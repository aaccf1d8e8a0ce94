// StateFolder: what leaves it for a backup, and what comes back.
#include "server/store/file.h"
#include "server/store/state_folder.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <new>
#include <utility>

namespace raynest::server {
namespace fs = std::filesystem;

StateCopy::~StateCopy() {
    if (!manifest.empty()) state.discard(std::move(manifest));
}

void StateFolder::discard(fs::path file) noexcept {
    try {
        const std::lock_guard guard(pins_->mutex);
        pins_->discarded.push_back(std::move(file));
    } catch (const std::bad_alloc&) {
        // The next start removes it.
    }
}

StoredScene ReturningScene::new_row() const {
    StoredScene made = row;
    made.number = number;
    made.epoch += later;
    return made;
}

KeptEdits ReturningScene::new_edits() const {
    KeptEdits made = edits;
    made.last.number = number;
    made.last.epoch += later;
    made.last.before += later;
    made.epoch_last += later;
    return made;
}

Result<void> StateFolder::put_locked(const StoredScene& row) {
    if (is_sound(row)) return manifest_->put(row);
    return fail(ErrorCode::io_failed, "the scene '" + row.name + "' has what no row may have");
}

Result<std::unique_ptr<StateCopy>> StateFolder::copy() {
    const std::lock_guard lock(mutex_);
    commit_locked();
    std::optional<Manifest> opened;
    if (!manifest_) {
        auto again = Manifest::open(folder_ / "manifest.sqlite", true);
        if (!again) return tl::unexpected(again.error());
        opened = std::move(*again);
    }
    Manifest& manifest = manifest_ ? *manifest_ : *opened;
    auto copy = std::make_unique<StateCopy>(*this);
    copy->manifest = new_path();
    if (const auto copied = manifest.copy_to(copy->manifest); !copied)
        return fail(ErrorCode::io_failed, copied.error().message +
                                              "; see to its disk, or copy the folder to another "
                                              "disk with raynestd backup");
    std::error_code error;
    copy->manifest_bytes = fs::file_size(copy->manifest, error);
    auto rows = manifest.rows();
    if (!rows) return tl::unexpected(rows.error());
    copy->rows = std::move(*rows);
    for (const StoredScene& row : copy->rows) copy->pins.push_back(pin(row.digest));
    return copy;
}

Result<std::map<std::string, BlobPin>> StateFolder::take_blobs(
    const std::map<std::string, fs::path>& files) {
    {
        const std::lock_guard lock(mutex_);
        if (const auto good = usable(); !good) return tl::unexpected(good.error());
    }
    std::map<std::string, BlobPin> pins;
    for (const auto& [digest, file] : files) {
        pins[digest] = pin(digest);
        struct stat there {};
        struct stat here {};
        const std::lock_guard guard(pins_->mutex);
        // One that is there may be in use, and has been checked or will be.
        if (::lstat(blob(digest).c_str(), &there) == 0 && ::lstat(file.c_str(), &here) == 0 &&
            there.st_size == here.st_size)
            continue;
        if (::rename(file.c_str(), blob(digest).c_str()) != 0)
            return fail(ErrorCode::io_failed,
                        "cannot put " + blob(digest).string() + " in its place: " + reason(errno));
    }
    if (!flush_folder(folder_ / "blobs")) return flush_failed(errno);
    return pins;
}

Result<void> StateFolder::put(const std::vector<ReturningScene>& scenes, Manifest& backup) {
    const std::lock_guard lock(mutex_);
    commit_locked();
    if (const auto good = usable(); !good) return good;
    const auto put_one = [&](const ReturningScene& scene) -> Result<void> {
        if (auto put = put_locked(scene.new_row()); !put) return put;
        auto edits = backup.edits(scene.row.number);
        if (!edits) return tl::unexpected(edits.error());
        edits->push_back({.number = scene.number, .epoch = scene.edits.epoch_last});
        if (scene.edits.epoch_last <= scene.edits.last.epoch) edits->pop_back();
        for (KeptEdit& edit : *edits) {
            edit.number = scene.number;
            edit.epoch += scene.later;
            edit.before += scene.later;
            if (auto put = manifest_->put(edit); !put) return put;
        }
        return {};
    };
    const auto put = timed([&] {
        return manifest_->together([&]() -> Result<void> {
            for (const ReturningScene& scene : scenes)
                if (auto done = put_one(scene); !done) return done;
            return {};
        });
    });
    if (!put) return put;
    for (const ReturningScene& scene : scenes) enter_locked(scene.new_row());
    return {};
}

}  // namespace raynest::server

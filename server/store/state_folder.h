// The folder of --state: scenes that outlive the daemon.
//
//   DIR/lock              held while a daemon runs (options/ready_file.h)
//   DIR/manifest.sqlite   a row per owner and name, and the kept edits since it was committed
//   DIR/blobs/DIGEST      the arena of a scene (scene/FORMAT.md), named by its digest
//   DIR/damaged/DIGEST    blobs that are not as they were written; kept for a look, never read
//
// A blob is written to a temporary name, flushed, renamed, and its folder flushed; then its row is
// committed; then the load is answered. Blobs are never changed: they are read and unlinked alone.
// Edits are seen at once and committed together: what one commit finds waiting is one transaction.
#pragma once

#include "engine/scene/snapshot.h"
#include "server/ground/metrics.h"
#include "server/store/manifest.h"

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {

/// Keeps a blob in the folder, with or without a row; holds its digest.
using BlobPin = std::shared_ptr<const std::string>;

/// A kept edit that everybody sees already, on its way to the disk.
struct Keeping {
    /// The whole scene, whose blob is kept; null: `edit` has a change
    std::unique_ptr<StoredScene> row = {};
    KeptEdit edit = {};
    std::uint64_t ended = 0;  ///< the number of the row in whose place `row` is put
    std::optional<Result<void>> outcome = {};  ///< for StateFolder
};

/// Why a blob cannot be used.
struct BlobFault {
    bool damaged = false;  ///< false: the system cannot read it now
    std::string why;
    bool of_another_release = false;  ///< the bytes are whole, and that release reads them
    std::uint64_t inode = 0;          ///< the inode of the file that was read
    bool of_edits = false;            ///< the blob is whole, and an edit since is damaged
};

/// The contents of a backup: a copy of the manifest, whose file goes with it, and all that it names.
struct StateCopy {
    std::filesystem::path manifest;
    std::uint64_t manifest_bytes = 0;
    std::vector<StoredScene> rows;
    std::vector<BlobPin> pins;

    explicit StateCopy(class StateFolder& folder) : state(folder) {}
    StateCopy(const StateCopy&) = delete;
    StateCopy& operator=(const StateCopy&) = delete;
    ~StateCopy();

    class StateFolder& state;
};

/// A scene that comes back from a backup.
struct ReturningScene {
    StoredScene row;           ///< as it is there
    KeptEdits edits;           ///< likewise
    std::uint64_t number = 0;  ///< the new one of its row
    std::uint64_t later = 0;   ///< what is added to its epochs
    BlobPin blob = {};
    std::optional<StoredScene> before = {};  ///< the damaged scene in whose place it comes
    bool is_damaged = false;                 ///< in the backup
    /// The row and the sum of edits that it has from now on.
    [[nodiscard]] StoredScene new_row() const;
    [[nodiscard]] KeptEdits new_edits() const;
};

/// Reads the blob of a scene in the state folder `folder`, and checks its digest and its arena.
/// Blocks; throws std::bad_alloc.
[[nodiscard]] tl::expected<std::shared_ptr<const Snapshot>, BlobFault> read_stored(
    const std::filesystem::path& folder, const std::string& digest, std::uint64_t bytes,
    std::string content);

/// Returns the name of a network file system by its number in statfs; null for others. A manifest
/// may be damaged there, and a lock may hold nobody off.
[[nodiscard]] const char* network_file_system(std::uint64_t magic);

/// The open folder; its lock is taken already. Thread-safe. Functions block but for pins' end.
class StateFolder {
public:
    using Stopped = std::function<bool()>;

    /// Opens the folder, or returns null for an empty name. Makes what is missing, and removes
    /// unfinished files and blobs without a row. Fails with io_failed on network file systems, and
    /// as Manifest::open() does.
    ///
    /// `leftovers`: with `keep`, files without a row stay until remove_leftovers(), since the daemon
    /// before, which has closed the folder, still reads some.
    enum class Leftovers { remove, keep };
    static Result<std::unique_ptr<StateFolder>> open(const std::filesystem::path& folder,
                                                     Leftovers leftovers = Leftovers::remove);
    void remove_leftovers();

    /// Commits what waits and closes the manifest, for another daemon to open it: the blobs can be
    /// read, and what would change the folder fails.
    void close();
    /// Opens the manifest again, if no other daemon has changed the folder. Fails as open() does;
    /// then the folder stays closed.
    [[nodiscard]] Result<void> reopen();
    [[nodiscard]] bool is_closed() const { return closed_; }

    /// The rows at the start.
    [[nodiscard]] const std::vector<StoredScene>& found() const { return found_; }
    /// The edits of each of these, summed up.
    [[nodiscard]] const std::vector<KeptEdits>& found_edits() const { return found_edits_; }
    /// The uses of the rows that have one, by number.
    [[nodiscard]] const std::map<std::uint64_t, SceneUse>& found_uses() const {
        return found_uses_;
    }
    /// A number larger than that of all rows.
    [[nodiscard]] std::uint64_t next_number() { return ++last_number_; }

    /// Writes the blob of a scene unless it is there. Fails with io_failed, and leaves nothing, if
    /// the disk is full or fails.
    [[nodiscard]] Result<BlobPin> keep(const std::string& digest, std::span<const std::byte> arena,
                                       const Stopped& stopped);
    /// Keeps a blob that has a row.
    [[nodiscard]] BlobPin pin(const std::string& digest);
    /// Commits a row, whose blob is kept.
    [[nodiscard]] Result<void> put(const StoredScene& scene);
    /// Removes rows as Manifest::remove() does.
    [[nodiscard]] Result<void> remove(const std::vector<StoredScene>& scenes);
    /// Undoes put() for a load that has ended before its scene was published; at the next
    /// collect().
    void undo(StoredScene scene, std::unique_ptr<StoredScene> before);

    /// Takes an edit, which later ones follow on the disk, too. Does not block.
    void hand_in(std::shared_ptr<Keeping> edit);
    /// Commits it with all others that were handed in meanwhile. One that follows a failed one
    /// fails.
    [[nodiscard]] Result<void> commit(const std::shared_ptr<Keeping>& edit);
    /// Commits that epochs up to this one were told.
    [[nodiscard]] Result<void> reserve(std::uint64_t number, std::uint64_t epoch);
    /// Returns the edits of a row as Manifest::edits() does.
    [[nodiscard]] Result<std::vector<KeptEdit>> edits(std::uint64_t number);
    /// Lets go of the edits of a row that is gone for good; at the next collect().
    void forget(std::uint64_t number);

    /// Notes uses for the next daemon; at the next collect() or close(). Does not block.
    void note(const std::vector<SceneUse>& uses);
    /// Notes them at once.
    [[nodiscard]] Result<void> put(const std::vector<SceneUse>& uses);

    [[nodiscard]] const std::filesystem::path& path() const { return folder_; }
    /// Returns the path of a file to be made, which no scene has. The next start removes it.
    [[nodiscard]] std::filesystem::path new_path();
    /// Removes such a file, at the next collect(): to unlink a large one takes long.
    void discard(std::filesystem::path file) noexcept;
    /// Stores nothing more after a failed flush, and returns the error that says so.
    tl::unexpected<Error> flush_failed(int error);
    /// Copies the manifest as it is now. Fails with io_failed.
    [[nodiscard]] Result<std::unique_ptr<StateCopy>> copy();
    /// Takes flushed files as the blobs of these digests, unless such a blob is there, and keeps
    /// them. Fails with io_failed.
    [[nodiscard]] Result<std::map<std::string, BlobPin>> take_blobs(
        const std::map<std::string, std::filesystem::path>& files);
    /// Commits the rows of scenes, whose blobs are kept, with their edits in the manifest of the
    /// backup: of all or none.
    [[nodiscard]] Result<void> put(const std::vector<ReturningScene>& scenes, Manifest& backup);

    /// Moves a damaged blob, the file of this inode, out of the way, so that a load writes it anew.
    /// One that has been written anew stays.
    void set_aside(const std::string& digest, std::uint64_t inode);
    /// Removes blobs that lost their last row and pin.
    void collect();
    [[nodiscard]] bool has_work();

    /// Keeps other loads of this owner and name waiting until the result is destroyed; null if
    /// stopped.
    [[nodiscard]] std::shared_ptr<void> lock_name(const std::string& owner, const std::string& name,
                                                  const Stopped& stopped);

    /// False once the disk has failed: nothing more is stored before a restart. Any thread.
    [[nodiscard]] bool stores() const { return !failed_; }
    /// Times of commits that loads and edits wait for. Any thread.
    [[nodiscard]] const DurationHistogram& commits() const { return commits_; }

private:
    StateFolder(std::filesystem::path folder, Manifest manifest)
        : folder_(std::move(folder)),
          manifest_(std::move(manifest)) {}
    [[nodiscard]] std::filesystem::path blob(const std::string& digest) const {
        return folder_ / "blobs" / digest;
    }
    void let_go(const std::string& digest);
    void collect_locked();
    void commit_locked();
    /// Puts a row, unless the next start would refuse it.
    [[nodiscard]] Result<void> put_locked(const StoredScene& row);
    /// Notes that a row stands for its owner and name.
    void enter_locked(const StoredScene& row);
    [[nodiscard]] Result<void> write_blob(const std::string& digest,
                                          std::span<const std::byte> arena, const Stopped& stopped);
    /// Fails once the disk has failed. Called with mutex_ locked, which the manifest's word of that
    /// needs.
    [[nodiscard]] Result<void> usable() const;
    /// Runs a commit, and notes its time and whether the disk has failed. Called with mutex_ locked.
    Result<void> timed(const std::function<Result<void>()>& commit);

    const std::filesystem::path folder_;
    std::vector<StoredScene> found_;
    std::vector<KeptEdits> found_edits_;
    std::map<std::uint64_t, SceneUse> found_uses_;
    std::atomic<std::uint64_t> last_number_{0};
    std::atomic<std::uint64_t> last_temporary_{0};
    std::atomic<bool> failed_{false};
    DurationHistogram commits_;
    std::atomic<bool> closed_{false};
    std::mutex mutex_;                  ///< for the manifest and what follows
    std::optional<Manifest> manifest_;  ///< nothing: closed_
    struct Row {
        std::string digest;
        std::uint64_t number = 0;
    };
    std::map<std::pair<std::string, std::string>, Row> rows_;  ///< by owner and name
    std::set<std::uint64_t> broken_;  ///< numbers of rows of which an edit could not be committed
    /// Pins and loads end on any thread, also the io thread: they take this lock alone.
    struct Pins {
        std::mutex mutex;
        std::map<std::string, std::weak_ptr<const std::string>> live;
        std::set<std::string> ended;
        std::vector<std::pair<StoredScene, std::unique_ptr<StoredScene>>> undone;
        std::vector<std::shared_ptr<Keeping>> keeping;
        std::vector<std::uint64_t> forgotten;
        std::vector<SceneUse> uses;
        std::vector<std::filesystem::path> discarded;
    };
    const std::shared_ptr<Pins> pins_ = std::make_shared<Pins>();
    std::mutex names_mutex_;
    std::condition_variable name_free_;
    std::set<std::pair<std::string, std::string>> names_;
};

}  // namespace raynest::server

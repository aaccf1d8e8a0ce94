// The manifest of a state folder: the stored scenes of all owners, in a file of SQLite.
#pragma once

#include "engine/result.h"
#include "server/store/share_list.h"

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

struct sqlite3;

namespace raynest::server {

/// A row: all that is known of a stored scene.
struct StoredScene {
    std::uint64_t number = 0;  ///< grows with each publication of the folder
    std::string owner;
    std::string name;
    ShareList share = {};
    std::string digest;        ///< names its blob
    std::string content = {};  ///< Snapshot::digest(); empty: an older release wrote it
    std::uint64_t epoch = 0;
    std::uint64_t bytes = 0;                ///< bytes of the blob
    std::uint64_t instanced_triangles = 0;  ///< for lists, which read no blob
    double build_seconds = 0;
    std::int64_t used = 0;  ///< Unix time
};

/// An edit that outlives the daemon: `change` turns the scene of a row into what it is at `epoch`.
/// Without `change` it says that epochs up to this one were told, and must mean nothing else after
/// a restart.
struct KeptEdit {
    std::uint64_t number = 0;  ///< number of the scene's row
    std::uint64_t epoch = 0;
    std::uint64_t before = 0;  ///< the epoch that it changes
    std::string digest = {};   ///< the scene's content at `epoch`; in older rows its arena
    std::uint64_t bytes = 0;   ///< likewise
    std::uint64_t instanced_triangles = 0;
    std::vector<std::byte> change = {};
};

/// Says which of a row's edits does not follow the one before; the first one follows the scene at
/// `epoch`. "" if all do.
[[nodiscard]] std::string gap_in(const std::vector<KeptEdit>& edits, std::uint64_t epoch);

/// The edits of a row, summed up.
struct KeptEdits {
    KeptEdit last = {};            ///< without its change; epoch 0: there is none
    std::uint64_t epoch_last = 0;  ///< the last of all that were told
    std::uint64_t count = 0;
    std::uint64_t bytes = 0;  ///< bytes of the changes
};

/// When a scene was last used, and whether it is pinned: what the next daemon begins with. It is
/// advice, so a damaged or missing one changes no scene.
struct SceneUse {
    std::uint64_t number = 0;  ///< number of the scene's row
    std::int64_t used_ms = 0;  ///< Unix time
    bool pinned = false;
};

/// True for what a row may have. A checksum tells damage alone: whoever can write rows can write
/// checksums, too.
[[nodiscard]] bool is_sound(const StoredScene& scene);

/// True for what names a blob: 64 hex digits.
[[nodiscard]] bool is_digest(std::string_view text);

/// The version of the manifest's tables. Another release may write a larger one, which this one
/// refuses.
inline constexpr int manifest_version = 3;

/// An open manifest. Every change is on the disk when its function returns. Not thread-safe;
/// blocks.
class Manifest {
public:
    /// Opens the file, or makes it. Fails with io_failed if it is damaged, of a newer version or of
    /// another program, or cannot be written; then nothing is changed. `read_only`: makes and
    /// changes none.
    static Result<Manifest> open(const std::filesystem::path& file, bool read_only = false);

    /// Returns all rows, by number. Fails if one is not as it was written.
    [[nodiscard]] Result<std::vector<StoredScene>> rows();
    /// Puts a row in the place of the owner's of that name.
    [[nodiscard]] Result<void> put(const StoredScene& scene);
    /// Removes the owner's row of that name, unless its number is larger.
    [[nodiscard]] Result<void> remove(const std::string& owner, const std::string& name,
                                      std::uint64_t number);
    /// Commits all that `changes` does, or nothing if that fails.
    [[nodiscard]] Result<void> together(const std::function<Result<void>()>& changes);
    [[nodiscard]] Result<void> put(const KeptEdit& edit);
    [[nodiscard]] Result<void> remove_edits(std::uint64_t number);
    /// Removes the edits and uses of all rows that are gone.
    [[nodiscard]] Result<void> remove_orphans();
    /// Returns the edits of a row that have a change, by epoch. Fails if one is not as it was
    /// written.
    [[nodiscard]] Result<std::vector<KeptEdit>> edits(std::uint64_t number);
    [[nodiscard]] Result<KeptEdits> sum_of_edits(std::uint64_t number);
    /// Puts all of these in one commit.
    [[nodiscard]] Result<void> put(const std::vector<SceneUse>& uses);
    [[nodiscard]] Result<std::vector<SceneUse>> uses();
    /// Writes all of it, as it is at one moment, to a new file.
    [[nodiscard]] Result<void> copy_to(const std::filesystem::path& file);
    /// True once the disk has failed: what is written after that may be lost, so nothing is.
    [[nodiscard]] bool failed() const { return failed_; }

private:
    struct Close {
        void operator()(sqlite3* connection) const noexcept;
    };
    class Statement;
    Manifest() = default;
    [[nodiscard]] Result<void> run(const char* sql);
    [[nodiscard]] tl::unexpected<Error> fault(const std::string& doing);
    [[nodiscard]] Result<void> check();

    std::string file_;
    std::unique_ptr<sqlite3, Close> connection_;
    bool failed_ = false;
    bool has_edits_ = true;  ///< false: written by a release that kept none, and opened to be read
    bool has_content_ = true;  ///< false: written by a release that did not note it
};

}  // namespace raynest::server

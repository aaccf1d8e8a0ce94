// The manifest of a state folder: the stored scenes of all owners, in a file of SQLite.
#pragma once

#include "engine/result.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

struct sqlite3;

namespace raynest::server {

/// A row: all that is known of a stored scene.
struct StoredScene {
    std::uint64_t number = 0;  ///< grows with each publication of the folder
    std::string owner;
    std::string name;
    std::vector<std::string> share = {};  ///< principals, or "public"
    std::string digest;                   ///< names its blob
    std::uint64_t epoch = 0;
    std::uint64_t bytes = 0;                ///< of the blob
    std::uint64_t instanced_triangles = 0;  ///< for lists, which read no blob
    double build_seconds = 0;
    std::int64_t used = 0;  ///< Unix time
};

/// The version of the manifest's tables. Another release may write a larger one, which this one refuses.
inline constexpr int manifest_version = 1;

/// An open manifest. Every change is on the disk when its function returns. Not thread-safe; blocks.
class Manifest {
public:
    /// Opens the file, or makes it. Fails with io_failed if it is damaged, of a newer version or of
    /// another program, or cannot be written; then nothing is changed. `read_only`: makes and changes none.
    static Result<Manifest> open(const std::filesystem::path& file, bool read_only = false);

    /// Returns all rows, by number. Fails if one is not as it was written.
    [[nodiscard]] Result<std::vector<StoredScene>> rows();
    /// Puts a row in the place of the owner's of that name.
    [[nodiscard]] Result<void> put(const StoredScene& scene);
    /// Removes the owner's row of that name, unless its number is larger.
    [[nodiscard]] Result<void> remove(const std::string& owner, const std::string& name,
                                      std::uint64_t number);
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
};

}  // namespace raynest::server

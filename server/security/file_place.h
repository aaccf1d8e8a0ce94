// Where a file is: an open folder and a name in it. Symbolic links are followed once, when the
// place is found. Whoever owns a link, or a folder on the way, can lead nobody elsewhere
// afterwards.
#pragma once

#include "engine/result.h"
#include "engine/system/child_process.h"

#include <sys/types.h>

#include <filesystem>
#include <memory>
#include <string>

namespace raynest::server {

/// Copies share the folder's descriptor.
class FilePlace {
public:
    /// Finds the place that a path means, behind its symbolic links; the file itself may be
    /// missing. Fails if the folder is missing, if the last link leads nowhere, or if a link
    /// belongs to a user who owns neither this process nor the file: such a link could lead root to
    /// any file.
    [[nodiscard]] static Result<FilePlace> find(const std::filesystem::path& path);

    /// The file's path behind the links, for messages.
    [[nodiscard]] const std::filesystem::path& path() const { return path_; }
    [[nodiscard]] const std::string& name() const { return name_; }
    /// The folder, for calls such as openat(); opened with O_PATH.
    [[nodiscard]] int folder() const { return folder_->get(); }
    /// True if something is there now.
    [[nodiscard]] bool exists() const;
    /// Opens the folder to lock or to sync it; -1 with errno on failure.
    [[nodiscard]] Fd open_folder() const;

private:
    FilePlace() = default;
    /// Opens the folder of `path`, which may be relative to the present one.
    [[nodiscard]] bool enter(const std::filesystem::path& path);

    std::shared_ptr<const Fd> folder_;
    std::filesystem::path path_;
    std::string name_;
};

/// True if the machine's users are in this group by default.
[[nodiscard]] bool is_everybodys(gid_t group);

/// Returns why others than this user and root could change a file or folder; empty if they cannot, or
/// if it is not there. `harm`: what they could do by that, as "change the scenes".
[[nodiscard]] std::string others_fault(const std::filesystem::path& path, const std::string& harm);
/// As others_fault(), and asks too whether they could put another one in its place, in its folder or
/// that of the link's target. For all that decides who gets in or what runs.
[[nodiscard]] std::string place_fault(const std::filesystem::path& path, const std::string& harm);

/// The failure of a file: io_failed, its path and why.
[[nodiscard]] tl::unexpected<Error> file_failed(const std::filesystem::path& file,
                                                const std::string& why);

}  // namespace raynest::server

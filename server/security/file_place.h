// Where a file is: an open folder and a name in it. One walk from the root folder finds the place, part
// by part. Whoever owns a link, or a folder on the way, can lead nobody elsewhere afterwards.
//
// For all that decides who gets in or what runs, the same walk asks who else could change the file. Others
// than root and this process's user may neither own nor write to a folder or link on the way, or the file;
// in a folder such as /tmp, everybody may only take away what is theirs. A folder that is mounted
// read-only is asked, too: others may write to it elsewhere. The owner of the root folder is trusted as root
// is: in a user namespace, root may have another number.
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
    /// any file. With `harm`, what others could do by a change of the file, as "change the options",
    /// fails if they could.
    [[nodiscard]] static Result<FilePlace> find(const std::filesystem::path& path,
                                                const std::string& harm = "");

    /// The file's path behind the links, for messages.
    [[nodiscard]] const std::filesystem::path& path() const { return path_; }
    [[nodiscard]] const std::string& name() const { return name_; }
    /// The folder, for calls such as openat(); opened with O_PATH.
    [[nodiscard]] int folder() const { return folder_->get(); }
    /// True if something is there now.
    [[nodiscard]] bool exists() const;
    /// Opens the folder to lock or to sync it; -1 with errno on failure.
    [[nodiscard]] Fd open_folder() const;

    /// As others_fault(), about the file that was opened here; empty if the place was found without a
    /// harm.
    [[nodiscard]] std::string fault(const Fd& opened) const;

private:
    FilePlace() = default;

    std::shared_ptr<const Fd> folder_;
    std::filesystem::path path_;
    std::string name_;
    std::string harm_;
};

/// True if the machine's users are in this group by default.
[[nodiscard]] bool is_everybodys(gid_t group);

/// Returns why others than this user and root could change a file or folder, or the link in its place;
/// empty if they cannot, or if it is not there. The group of this process may write where nobody else is
/// in it, as where each user has a group.
[[nodiscard]] std::string others_fault(const std::filesystem::path& path, const std::string& harm);
/// As others_fault(), and asks too whether they could put another one in its place.
[[nodiscard]] std::string place_fault(const std::filesystem::path& path, const std::string& harm);

/// The failure of a file: io_failed, its path and why.
[[nodiscard]] tl::unexpected<Error> file_failed(const std::filesystem::path& file,
                                                const std::string& why);

}  // namespace raynest::server

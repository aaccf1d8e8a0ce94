// Receives the files of a scene, imports them and publishes the scene.
//
// The import runs in a process of its own; a thread of the blocking pool waits for it.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/scene/description.h"
#include "protocol/buffer.h"
#include "protocol/openssl.h"
#include "server/scheduling/job.h"
#include "server/security/caller.h"
#include "server/store/scene_store.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

struct Services;

/// A file of an upload; its data arrive in pieces.
struct UploadFile {
    std::string name;
    std::uint64_t hash = 0;  ///< counts where there is no digest
    std::optional<protocol::Sha256Digest> digest;
    protocol::Buffer bytes;
    std::uint64_t received = 0;
};

/// A scene in files of this machine: `path` is looked up in the folder `root`.
struct DiskSource {
    std::filesystem::path root;
    std::string path;
};

/// The checked contents of a LOAD request.
struct LoadOrder {
    std::string source;
    std::string name;
    std::string primitive;
    ConnectionId caller;
    BuildQuality build = BuildQuality::medium;
    Publication publication;
    WorldPoint origin{};
    FileOptions options{};
    std::vector<std::string> masks;
    std::string variant = {};
    std::optional<DiskSource> disk;  ///< nothing: a built-in scene or an upload
    std::vector<UploadFile> files;
    Budget::Lease lease;                     ///< for the received bytes of the files
    std::shared_ptr<const HeldScene> known;  ///< the scene that the upload would make
};

[[nodiscard]] std::unique_ptr<Job> load_job(const Services& services, const Caller& caller,
                                            LoadOrder order);

}  // namespace raynest::server

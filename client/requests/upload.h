// Reads and sends the SOURCE of `raynest load`.
//
//   builtin:..., root:...     only a name: the daemon has it
//   .glb, .gltf               the file and what it names, read beneath its folder
//   .obj                      the file, its MTL files and their pictures
//   .rnscene.json             the composition, its files and what these name
//   .ply .stl .off .npz .las  the file; so .tif
//   .npy                      records of a primitive type, with --primitive; --instances beside it
//   -, /dev/stdin, /dev/fd/N  one of these out of a pipe; what a .gltf names is then looked for in
//                             the current folder
//   any other file or pipe    one of these, told apart by its first bytes
//
// Load carries the digest of each file: the daemon asks for none of a scene that it has.
// Bad files are refused with exit code 5 before anything is sent; the daemon checks again.
#pragma once

#include "client/ground/failure.h"
#include "client/ground/progress.h"
#include "client/net/connection.h"
#include "protocol/buffer.h"
#include "protocol/openssl.h"

#include <array>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// Endings of the files that are scenes.
inline constexpr std::array<std::string_view, 12> scene_endings = {
    ".glb", ".gltf", ".npy", ".ply", ".stl",  ".obj",
    ".off", ".npz",  ".las", ".tif", ".tiff", ".rnscene.json"};

/// Returns the ending of a path that tells what a file is, in small letters: ".glb",
/// ".rnscene.json", or "".
[[nodiscard]] std::string scene_ending_of(const std::string& path);

/// Returns what there is to say of a file of another kind, by its ending; "" of scenes and unknown kinds.
[[nodiscard]] std::string_view said_of_others(std::string_view ending);

struct UploadFile {
    std::string name;  ///< the name that the main file uses
    protocol::Buffer bytes;
    protocol::Sha256Digest digest{};
};

struct Upload {
    std::string source;                   ///< name of the main file, or the source itself
    std::string scene_name;               ///< the stem of the source; may be empty
    std::vector<UploadFile> files;        ///< the main file first; empty for builtin: and root:
    std::vector<std::string> warnings{};  ///< why pictures were left out
};

/// `primitive` and `instances` belong to a .npy source and are empty otherwise.
Result<Upload> gather(const std::string& source, const std::string& primitive,
                      const std::string& instances);

/// Answers a NEED of the running Load: sends the listed files in several frames, as credit
/// allows.
Result<void> send_files(Connection& connection, const Upload& upload, const wire::Need& need,
                        Progress& progress);

}  // namespace raynest::client

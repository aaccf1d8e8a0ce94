#include "client/requests/upload.h"

#include "client/files/files.h"
#include "client/files/named_files.h"
#include "client/ground/interrupt.h"
#include "client/ground/wording.h"
#include "client/requests/send_file.h"
#include "protocol/limits.h"
#include "protocol/text.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <set>
#include <utility>

namespace raynest::client {
namespace {

using namespace std::string_view_literals;

struct OtherFiles {
    std::string_view endings;
    std::string_view text;
};
constexpr std::array other_files = {
#define RAYNEST_OTHER_FILES(endings, text) OtherFiles{endings, text},
#include "client/requests/other_files.def"
};

std::string folder_of(const std::string& path) {
    const std::size_t slash = path.rfind('/');
    return slash == std::string::npos ? "." : path.substr(0, slash + 1);
}

std::string file_name_of(const std::string& path) {
    const std::size_t slash = path.rfind('/');
    return slash == std::string::npos ? path : path.substr(slash + 1);
}

std::string stem_of(const std::string& name) {
    return name.ends_with(composition_ending)
               ? name.substr(0, name.size() - composition_ending.size())
               : name.substr(0, name.rfind('.'));
}

/// A path that is no name for a scene: stdin, or a pipe of the shell as in <(command).
bool is_nameless(const std::string& path) {
    return path == standard_stream || path == "/dev/stdin" || path.starts_with("/dev/fd/");
}

bool is_known(const std::string& extension) {
    return std::ranges::find(scene_endings, extension) != scene_endings.end();
}

/// Returns the file ending that fits the first bytes, or "".
std::string sniff(std::span<const std::byte> bytes) {
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    if (text.starts_with("glTF")) return ".glb";
    if (text.starts_with("\x93NUMPY")) return ".npy";
    if (text.starts_with("ply\n") || text.starts_with("ply\r")) return ".ply";
    if (text.starts_with("LASF")) return ".las";
    if (text.starts_with("PK\x03\x04")) return ".npz";
    if (text.starts_with("solid ")) return ".stl";
    if (text.starts_with("OFF") || text.starts_with("COFF")) return ".off";
    for (const std::string_view tiff : {"II*"sv, "II+"sv, "MM\0*"sv, "MM\0+"sv})
        if (text.starts_with(tiff)) return ".tif";
    const std::size_t letter = text.find_first_not_of(" \t\r\n");
    if (letter == std::string_view::npos || text[letter] != '{') return "";
    const bool is_composition = text.find("\"rnscene\"") != std::string_view::npos;
    return is_composition ? std::string(composition_ending) : ".gltf";
}

/// The same out of a pipe, where an OBJ is known by its first word: tools begin it with a comment, its
/// materials, a name or a vertex. So do other texts, whose files have endings.
std::string sniff_pipe(std::span<const std::byte> bytes) {
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    for (const std::string_view word : {"#", "mtllib ", "o ", "g ", "v "})
        if (text.starts_with(word)) return ".obj";
    return sniff(bytes);
}

constexpr std::size_t head_bytes = 256;

tl::unexpected<Failure> unknown_content(const std::string& source) {
    return fail(
        Exit::invalid,
        shown_name(source) +
            " brought no scene that is known by its first bytes: a .glb, .gltf, .npy, .ply, "
            ".stl, .obj, .off, .npz, .las or .tif; name a file of another kind by its ending");
}

/// Says why a source that exists or not is none that can be read, and what to do about it.
tl::unexpected<Failure> not_a_scene(const std::string& source) {
    std::error_code ignored;
    if (std::filesystem::is_directory(source, ignored))
        return fail(Exit::invalid, source + " is a folder; name the .glb or .gltf file in it");
    if (const std::string_view other = said_of_others(extension_of(source)); !other.empty())
        return fail(Exit::invalid, source + " " + localize_message(other));
    return fail(
        Exit::invalid,
        source +
            " is not a .glb, .gltf, .rnscene.json, .obj, .ply, .stl, .off, .las, .tif, .npz or "
            ".npy file, nor builtin:NAME; "
            "convert it to .glb, for example with trimesh or Blender");
}

/// The first bytes of a file, enough for sniff(); nothing where it cannot be read.
std::vector<std::byte> head_of(const std::string& path) {
    std::vector<std::byte> bytes(head_bytes);
    std::ifstream file(path, std::ios::binary);
    file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    bytes.resize(static_cast<std::size_t>(file.gcount()));
    return bytes;
}

/// Hashes in parts and checks for Ctrl-C between them: 4 GiB take seconds.
Result<protocol::Sha256Digest> digest_of(std::span<const std::byte> bytes) {
    constexpr std::size_t hashed_at_once = 16 << 20;
    protocol::Sha256 sum;
    while (!bytes.empty()) {
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        const std::size_t count = std::min(bytes.size(), hashed_at_once);
        sum.add(bytes.first(count));
        bytes = bytes.subspan(count);
    }
    const auto digest = sum.digest();
    if (!digest)
        return fail(
            Exit::failed,
            "libcrypto computes no SHA-256: check the OpenSSL configuration (OPENSSL_CONF)");
    return *digest;
}

/// Reads files until the sum of their bytes is over the limit.
class Gatherer {
public:
    explicit Gatherer(Upload& upload) : upload_(upload) {}

    /// Adds what `read` gives under `name`.
    Result<void> add(std::string name, Result<protocol::Buffer> bytes) {
        if (!bytes) return tl::unexpected<Failure>(bytes.error());
        left_ -= bytes->size();
        const auto digest = digest_of(std::as_const(*bytes).span());
        if (!digest) return tl::unexpected<Failure>(digest.error());
        upload_.files.push_back({std::move(name), std::move(*bytes), *digest});
        return {};
    }
    [[nodiscard]] std::uint64_t left() const { return left_; }

private:
    Upload& upload_;
    std::uint64_t left_ = protocol::Limits{}.upload_bytes_max;
};

/// Adds what the main file, which is there, names beneath `folder`, what these name in turn, and so
/// on. Whether a file that is not there is missed is for the daemon to say.
Result<void> gather_named(const std::string& path, const std::string& folder, Gatherer& gatherer,
                          Upload& upload) {
    std::set<std::string> known{upload.files.front().name};
    for (std::size_t i = 0; i < upload.files.size(); ++i) {
        const std::string by = i == 0 ? path : upload.files[i].name;
        const auto blame = [&](Exit exit, const std::string& why) {
            return fail(exit, by + " " + why);
        };
        const auto names =
            named_files(upload.files[i].name, std::as_const(upload.files[i].bytes).span());
        if (!names) return blame(names.error().exit, names.error().message);
        for (const auto& [name, spare] : *names) {
            if (!known.insert(name).second) continue;
            if (const std::uint64_t most = protocol::Limits{}.upload_files_max; known.size() > most)
                return blame(Exit::invalid, "names over " + std::to_string(most) +
                                                " files; pack it into one .glb");
            auto bytes = read_file_beneath(folder, name, gatherer.left());
            if (!bytes && !spare.empty() && bytes.error().exit == Exit::invalid) {
                upload.warnings.push_back("the " + std::string(spare) + " " +
                                          bytes.error().message + ". It is left out");
                continue;
            }
            if (!bytes) return blame(bytes.error().exit, "names " + bytes.error().message);
            if (!*bytes) continue;
            if (auto added = gatherer.add(name, std::move(**bytes)); !added) return added;
        }
    }
    return {};
}

}  // namespace

std::string scene_ending_of(const std::string& path) {
    return path.ends_with(composition_ending) ? std::string(composition_ending)
                                              : extension_of(path);
}

std::string_view said_of_others(std::string_view ending) {
    if (ending.empty()) return "";
    const std::string word = " " + std::string(ending) + " ";
    for (const auto& [endings, text] : other_files)
        if ((" " + std::string(endings) + " ").find(word) != std::string::npos) return text;
    return "";
}

Result<Upload> gather(const std::string& source, const std::string& primitive,
                      const std::string& instances) {
    Upload upload;
    upload.source = source;
    const auto check_records = [&](bool records) -> Result<void> {
        if (records || (primitive.empty() && instances.empty())) return {};
        return fail(Exit::usage,
                    "--primitive and --instances are for .npy files; " + source + " is none");
    };
    if (source.rfind("builtin:", 0) == 0 || source.rfind("root:", 0) == 0) {
        if (auto fits = check_records(false); !fits) return tl::unexpected<Failure>(fits.error());
        return upload;
    }

    const bool nameless = is_nameless(source);
    const std::string ending = scene_ending_of(source);
    const bool is_named_so = !nameless && is_known(ending);
    const bool is_piped = nameless || is_device(source);
    std::string extension = is_named_so ? ending : is_piped ? "" : sniff(head_of(source));
    if ((extension.empty() && !is_piped) || !said_of_others(ending).empty())
        return not_a_scene(source);
    Gatherer gatherer(upload);
    const auto check =
        [&](std::span<const std::byte> begin) -> Result<std::optional<std::uint64_t>> {
        if (extension.empty()) extension = sniff_pipe(begin);
        if (!extension.empty()) return gatherer.left();
        if (begin.size() < head_bytes) return std::nullopt;
        return unknown_content(source);
    };
    auto bytes = read_file(source, gatherer.left(), check);
    if (!bytes) return tl::unexpected<Failure>(bytes.error());
    if (bytes->size() == 0) return fail(Exit::invalid, shown_name(source) + " is empty");
    if (extension.empty()) return unknown_content(source);
    if (auto fits = check_records(extension == ".npy"); !fits)
        return tl::unexpected<Failure>(fits.error());
    if (extension == ".npy" && primitive.empty())
        return fail(Exit::usage,
                    shown_name(source) +
                        " holds records: say of what, for example with --primitive sphere, or "
                        "--primitive heights for a grid");

    // The name by which the daemon speaks of the file, in letters that may travel.
    std::string name = nameless ? "stdin" : file_name_of(source);
    if (!is_named_so) name += extension;
    upload.source = protocol::clean_text(name, protocol::Limits{}.name_bytes_max);
    if (!nameless)
        upload.scene_name = protocol::single_blanks(
            stem_of(is_named_so || ending.empty() ? upload.source : stem_of(upload.source)));
    Result<void> added = gatherer.add(upload.source, std::move(bytes));
    if (added) added = gather_named(source, nameless ? "." : folder_of(source), gatherer, upload);
    if (added && !instances.empty())
        added = gatherer.add(
            protocol::clean_text(file_name_of(instances), protocol::Limits{}.name_bytes_max),
            read_file(instances, gatherer.left()));
    if (!added) return tl::unexpected<Failure>(added.error());
    return upload;
}

Result<void> send_files(Connection& connection, const Upload& upload, const wire::Need& need,
                        Progress& progress) {
    std::uint64_t total = 0;
    std::uint64_t sent = 0;
    std::set<std::uint32_t> asked;
    const auto* const files = need.files();
    if (files == nullptr) return {};
    for (const std::uint32_t index : *files) {
        if (index >= upload.files.size() || !asked.insert(index).second)
            return fail(Exit::failed,
                        "the daemon asks for a file twice, or for one that was not offered");
        total += upload.files[index].bytes.size();
    }
    const FrameConsumer ignore = [](const protocol::Frame&) { return Result<void>(); };
    for (const std::uint32_t index : *files) {
        const std::span<const std::byte> bytes = upload.files[index].bytes.span();
        if (auto done = send_file(connection, index, bytes, progress, ignore, {sent, total}); !done)
            return done;
        sent += bytes.size();
    }
    return {};
}

}  // namespace raynest::client

#include "client/upload.h"

#include "client/files.h"
#include "client/gltf_names.h"
#include "protocol/hash.h"
#include "protocol/limits.h"

#include <algorithm>
#include <cctype>
#include <cstring>
#include <utility>

namespace raynest::client {
namespace {

/// A piece of a file: large enough that headers do not count, small enough for any frame limit.
constexpr std::uint64_t piece_bytes = 1ULL << 20;

std::string folder_of(const std::string& path) {
    const std::size_t slash = path.rfind('/');
    return slash == std::string::npos ? "." : path.substr(0, slash + 1);
}

std::string file_name_of(const std::string& path) {
    const std::size_t slash = path.rfind('/');
    return slash == std::string::npos ? path : path.substr(slash + 1);
}

std::string stem_of(const std::string& name) {
    return name.substr(0, name.rfind('.'));
}

std::string extension_of(const std::string& name) {
    const std::size_t dot = name.rfind('.');
    std::string extension = dot == std::string::npos ? "" : name.substr(dot);
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return extension;
}

/// Reads files until the sum of their bytes is over the limit.
class Gatherer {
public:
    explicit Gatherer(Upload& upload) : upload_(upload) {}

    /// Adds what `read` gives under `name`.
    Result<void> add(std::string name, Result<protocol::Buffer> bytes) {
        if (!bytes) return tl::unexpected<Failure>(bytes.error());
        left_ -= bytes->size();
        const std::uint64_t hash = protocol::content_hash(std::as_const(*bytes).span());
        upload_.files.push_back({std::move(name), std::move(*bytes), hash});
        return {};
    }
    [[nodiscard]] std::uint64_t left() const { return left_; }

private:
    Upload& upload_;
    std::uint64_t left_ = protocol::Limits{}.upload_bytes_max;
};

Result<void> gather_gltf(const std::string& path, Gatherer& gatherer, Upload& upload) {
    if (auto added = gatherer.add(file_name_of(path), read_file(path, gatherer.left())); !added)
        return added;
    const auto blame = [&](const Failure& why) { return fail(why.exit, path + " " + why.message); };
    const auto json = gltf_json(std::as_const(upload.files[0].bytes).span());
    if (!json) return blame(json.error());
    const auto names = gltf_names(*json);
    if (!names) return blame(names.error());
    const std::uint64_t files_max = protocol::Limits{}.upload_files_max;
    if (names->size() >= files_max)
        return blame(failure(Exit::invalid, "names " + std::to_string(names->size()) +
                                                " files; pack it into one .glb"));
    for (const std::string& name : *names) {
        if (name == upload.files[0].name) continue;
        auto bytes = read_file_beneath(folder_of(path), name, gatherer.left());
        if (!bytes) return blame(failure(bytes.error().exit, "names " + bytes.error().message));
        // Whether it is missed is for the daemon to say.
        if (!*bytes) continue;
        if (auto added = gatherer.add(name, std::move(**bytes)); !added) return added;
    }
    return {};
}

}  // namespace

Result<Upload> gather(const std::string& source, const std::string& primitive,
                      const std::string& instances) {
    Upload upload;
    upload.source = source;
    if (source.rfind("builtin:", 0) == 0 || source.rfind("root:", 0) == 0) return upload;

    upload.source = file_name_of(source);
    upload.scene_name = stem_of(upload.source);
    Gatherer gatherer(upload);
    const std::string extension = extension_of(source);
    if (extension == ".gltf" || extension == ".glb") {
        if (auto done = gather_gltf(source, gatherer, upload); !done)
            return tl::unexpected<Failure>(done.error());
    } else if (extension == ".npy") {
        if (primitive.empty())
            return fail(
                Exit::usage,
                source + " holds records: say of what, for example with --primitive sphere");
        upload.source = "points.npy";
        if (auto done = gatherer.add("points.npy", read_file(source, gatherer.left())); !done)
            return tl::unexpected<Failure>(done.error());
        if (!instances.empty()) {
            auto done = gatherer.add("instances.npy", read_file(instances, gatherer.left()));
            if (!done) return tl::unexpected<Failure>(done.error());
        }
    } else {
        return fail(Exit::invalid, source + " is not a .glb, .gltf or .npy file, nor builtin:NAME");
    }
    return upload;
}

Result<void> send_files(Connection& connection, const Upload& upload, const wire::Need& need,
                        Progress& progress) {
    std::uint64_t total = 0;
    std::uint64_t sent = 0;
    if (need.files() == nullptr) return {};
    for (const std::uint32_t index : *need.files()) {
        if (index >= upload.files.size())
            return fail(Exit::failed, "the daemon asks for a file that was not offered");
        total += upload.files[index].bytes.size();
    }
    for (const std::uint32_t index : *need.files()) {
        const std::span<const std::byte> bytes = upload.files[index].bytes.span();
        // A file of no bytes needs no piece.
        for (std::uint64_t offset = 0; offset < bytes.size();) {
            const std::uint64_t count =
                std::min({bytes.size() - offset, piece_bytes,
                          connection.bulk_bytes_max() & ~std::uint64_t{63}});
            while (connection.credit() < protocol::padded(count)) {
                if (auto frame = connection.next(); !frame)
                    return tl::unexpected<Failure>(frame.error());
            }
            protocol::Bulk bulk;
            bulk.add("data", wire::Dtype::u8, 1, count);
            bulk.allocate();
            std::memcpy(bulk.block(0).data(), bytes.data() + offset, count);
            wire::UploadT piece;
            piece.file = index;
            piece.offset = offset;
            if (auto done = connection.send_bulk(std::move(piece), std::move(bulk)); !done)
                return done;
            offset += count;
            sent += count;
            progress.update(sent, total, "uploading");
        }
    }
    return {};
}

}  // namespace raynest::client

#include "client/requests/scene_source.h"

#include "client/files/files.h"
#include "client/ground/wording.h"
#include "protocol/hash.h"
#include "protocol/limits.h"
#include "protocol/text.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <span>
#include <utility>

namespace raynest::client {
namespace {

bool has_scheme(const std::string& source) {
    return source.starts_with("builtin:") || source.starts_with("root:");
}

/// "forest" for forest.glb, builtin:forest?trees=9 and root:maps/forest.glb.
std::string stem_of(const Upload& upload) {
    if (!has_scheme(upload.source)) return upload.scene_name;
    std::string name = upload.source.substr(upload.source.find(':') + 1);
    name.erase(std::min(name.find('?'), name.size()));
    name.erase(0, name.rfind('/') + 1);
    return name.substr(0, name.rfind('.'));
}

/// "forest-7b19d4c2a0e35f68": equal sources have equal names.
std::string unique_name(const Upload& upload) {
    std::uint64_t hash =
        protocol::upload_checksum(std::as_bytes(std::span(std::as_const(upload.source))));
    for (const UploadFile& file : upload.files)
        hash = protocol::upload_checksum(std::as_bytes(std::span(file.digest)), hash);
    std::array<char, 24> digits{};
    const int length = std::snprintf(digits.data(), digits.size(), "-%016llx",
                                     static_cast<unsigned long long>(hash));
    const std::string stem = stem_of(upload);
    const std::size_t room = protocol::Limits{}.name_bytes_max - static_cast<std::size_t>(length);
    return protocol::clean_text(stem.empty() ? "scene" : stem, room) + digits.data();
}

}  // namespace

Result<Reply<wire::Loaded>> load_scene(Connection& connection, Progress& progress,
                                       wire::LoadT message, const Upload& upload) {
    if (!upload.warnings.empty()) progress.clear();
    for (const std::string& warning : upload.warnings) print_note(warning);
    message.source = upload.source;
    for (const UploadFile& file : upload.files) {
        message.file_names.push_back(file.name);
        message.file_digests.insert(message.file_digests.end(), file.digest.begin(),
                                    file.digest.end());
        message.file_bytes.push_back(file.bytes.size());
    }
    if (auto started = connection.start(message); !started)
        return tl::unexpected<Failure>(started.error());
    for (bool is_asked = false;;) {
        auto frame = connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (is<wire::Loaded>(*frame)) return open_reply<wire::Loaded>(std::move(*frame));
        if (is<wire::Need>(*frame)) {
            const auto need = open_reply<wire::Need>(std::move(*frame));
            if (!need) return tl::unexpected<Failure>(need.error());
            if (std::exchange(is_asked, true)) return daemon_sent("Need twice");
            const auto sent = send_files(connection, upload, *need->message.table, progress);
            if (!sent) return tl::unexpected<Failure>(sent.error());
        } else if (is<wire::Progress>(*frame)) {
            const auto news = open_sent<wire::Progress>(*frame);
            if (!news) return tl::unexpected<Failure>(news.error());
            progress.update((*news)->done(), (*news)->total(), protocol::text((*news)->stage()));
        }
    }
}

bool is_source(const std::string& scene) {
    if (has_scheme(scene)) return true;
    const std::string ending = scene_ending_of(scene);
    if (std::ranges::find(scene_endings, ending) != scene_endings.end()) return true;
    std::error_code ignored;
    if (!said_of_others(ending).empty() && std::filesystem::exists(scene, ignored))
        return true;  // gather() says what to do about it
    // A pipe of the shell, <(command), has no ending. A word without a slash is a scene's name even
    // where the folder happens to hold a file of that name.
    return scene.find('/') != std::string::npos && std::filesystem::exists(scene, ignored);
}

Result<std::string> load_for_connection(Connection& connection, Progress& progress,
                                        const std::string& source) {
    progress.update(0, 0, "reading");
    const Result<Upload> upload = gather(source, "", "");
    if (!upload) return tl::unexpected<Failure>(upload.error());
    wire::LoadT message;
    message.name = unique_name(*upload);
    message.temporary = true;
    const auto loaded = load_scene(connection, progress, std::move(message), *upload);
    progress.clear();
    if (!loaded) return tl::unexpected<Failure>(loaded.error());
    const wire::SceneInfo& info = protocol::present((*loaded)->info());
    for (const std::string& warning : protocol::strings(info.warnings()))
        print_note(shown_name(source) + ": " + localize_message(warning));
    return std::string(protocol::text(info.name()));
}

}  // namespace raynest::client

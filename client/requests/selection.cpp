#include "client/requests/selection.h"

#include "client/ground/json.h"
#include "client/requests/picture.h"

#include <cstdint>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

/// The outermost instance on the way to a path, as "inst=N".
Result<std::string> instance_of(Connection& connection, Progress& progress,
                                const std::string& scene, const std::string& text) {
    wire::PathT path;
    path.scene = scene;
    path.text = text;
    const auto found = ask<wire::PathName>(connection, path);
    if (!found) return tl::unexpected<Failure>(found.error());
    wire::StructureT structure;
    structure.scene = scene;
    structure.kind = "placements";
    structure.first = (*found)->path();
    structure.count = 1;
    if (auto started = connection.start(structure); !started)
        return tl::unexpected<Failure>(started.error());
    const auto answer = receive_picture(connection, progress);
    if (!answer) return tl::unexpected<Failure>(answer.error());
    const auto document = read_json(*answer);
    if (!document) return tl::unexpected<Failure>(document.error());
    const Json& rows = document->at("rows");
    if (rows.empty() || !rows[0].at("instance").is_number())
        return fail(Exit::usage, "'" + text + "' lies in no instance: it cannot be hidden");
    return "inst=" + std::to_string(rows[0].at("instance").get<std::uint64_t>());
}

}  // namespace

Result<void> find_selection(Connection& connection, Progress& progress, JobOptions& job) {
    for (auto* list : {&job.hide, &job.only}) {
        for (std::string& text : *list) {
            if (is_numbered(text)) continue;
            auto found = instance_of(connection, progress, job.scene, text);
            if (!found) return tl::unexpected<Failure>(found.error());
            text = std::move(*found);
        }
    }
    return {};
}

}  // namespace raynest::client

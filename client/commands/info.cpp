// raynest info SCENE: counts, cameras and skipped parts of a scene; or its meshes and materials.
#include "client/arguments/shared_options.h"
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/ground/text.h"
#include "client/output/output.h"
#include "client/output/scene_text.h"
#include "client/requests/job.h"
#include "client/requests/listings.h"
#include "client/requests/picture.h"

#include <chrono>
#include <iostream>

namespace raynest::client {
namespace {

struct InfoOptions {
    std::string scene;
    bool meshes = false;
    bool materials = false;
    MomentOptions moment;
};

/// A daemon that has no time for it leaves the EPO out.
constexpr std::chrono::milliseconds epo_wait{3000};

struct Parts {
    Json json = Json::array();
    std::vector<std::vector<std::string>> rows;
};

/// Reads all pages of the meshes or materials; `kind` is one of these words.
Result<Parts> list_parts(Connection& connection, const std::string& scene,
                         const std::string& kind) {
    const bool meshes = kind == "meshes";
    Parts parts;
    parts.rows.push_back(
        meshes ? std::vector<std::string>{"MESH", "TRIANGLES", "RECORDS", "PLACEMENTS"}
               : std::vector<std::string>{"MATERIAL", "ALPHA", "TRIANGLES", "PLACEMENTS"});
    wire::PartsT request;
    request.scene = scene;
    request.kind = kind;
    for (bool more = true; more;) {
        const auto page = ask<wire::PartList>(connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        const wire::PartList& list = *page->message.table;
        const std::vector<std::string> names = protocol::strings(list.names());
        if (auto fits = check_listed(parts.json.size() + names.size()); !fits)
            return tl::unexpected<Failure>(fits.error());
        const std::vector<std::string> alpha_modes = protocol::strings(list.alpha_modes());
        for (std::size_t k = 0; k < names.size(); ++k) {
            const auto i = static_cast<flatbuffers::uoffset_t>(k);
            const std::uint64_t triangles = list.triangles()->Get(i);
            const std::uint64_t records = list.records()->Get(i);
            const std::uint64_t placements = list.placements()->Get(i);
            Json json{{"name", names[k]}, {"triangles", triangles}, {"placements", placements}};
            if (meshes)
                json["records"] = records;
            else
                json["alpha_mode"] = alpha_modes[k];
            parts.json.push_back(std::move(json));
            const std::string name =
                !names[k].empty() ? names[k] : '#' + std::to_string(request.first + k);
            if (meshes)
                parts.rows.push_back(
                    {name, grouped(triangles), grouped(records), grouped(placements)});
            else
                parts.rows.push_back(
                    {name, alpha_modes[k], grouped(triangles), grouped(placements)});
        }
        request.first += static_cast<std::uint32_t>(names.size());
        more = !names.empty() && request.first < list.total();
    }
    return parts;
}

/// Asks for the EPO of the scene's trees, which takes a look at all of them: null where they have
/// none, where the scene was edited meanwhile, and on a daemon that is busy or knows no EPO.
Result<Json> ask_epo(Context& context, const wire::SceneInfo& info, const MomentOptions& moment) {
    wire::StructureT request;
    request.scene = protocol::text(info.name());
    request.epoch = info.epoch();
    request.kind = "tree";
    request.count = 1;
    request.deadline_ms = static_cast<std::uint32_t>(epo_wait.count());
    put_moment(moment, request);
    if (auto started = context.connection.start(request, epo_wait); !started)
        return tl::unexpected<Failure>(started.error());
    const auto answer = receive_file(context.connection, context.progress, document_room());
    context.progress.clear();
    if (!answer) {
        if (answer.error().exit == Exit::interrupted && is_own(answer.error()))
            return tl::unexpected<Failure>(answer.error());
        return Json(nullptr);
    }
    const auto document = read_json(*answer);
    if (!document) return tl::unexpected<Failure>(document.error());
    return document->value("epo", Json(nullptr));
}

}  // namespace

void declare(CommandLine& line, InfoOptions& info) {
    add_scene(line, info.scene);
    line.add_flag("--meshes", info.meshes,
                  "list its meshes: triangles of one copy, and placements");
    line.add_flag("--materials", info.materials,
                  "list its materials: alpha mode, and what uses them");
    const Option time = add_moment(line, info.moment);
    for (const char* list : {"--meshes", "--materials"}) time.excludes(line.find(list));
}

Result<void> run(Context& context, const InfoOptions& options) {
    Json lists = Json::object();
    for (const auto& [wanted, kind] :
         {std::pair{options.meshes, "meshes"}, std::pair{options.materials, "materials"}}) {
        if (!wanted) continue;
        auto parts = list_parts(context.connection, options.scene, kind);
        if (!parts) return tl::unexpected<Failure>(parts.error());
        if (!context.json) print_table(parts->rows);
        lists[kind] = std::move(parts->json);
    }
    if (options.meshes || options.materials) {
        if (context.json) print_json(lists);
        return {};
    }
    wire::InfoT request;
    request.scene = options.scene;
    put_moment(options.moment, request);
    const auto info = ask<wire::SceneInfo>(context.connection, request);
    if (!info) return tl::unexpected<Failure>(info.error());
    const auto epo = ask_epo(context, *info->message.table, options.moment);
    if (!epo) return tl::unexpected<Failure>(epo.error());
    if (context.json) {
        Json json = scene_json(*info->message.table);
        json["epo"] = *epo;
        if (options.moment.time) json["time"] = *options.moment.time;
        print_json(json);
    } else {
        print_scene(*info->message.table, *epo);
        if (options.moment.time)
            std::cout << "moment       " << Json(*options.moment.time).dump()
                      << " s of its animation: the box and the tree are those of then\n";
    }
    return {};
}

std::unique_ptr<Command> make_info() {
    return make_command<InfoOptions>();
}

}  // namespace raynest::client

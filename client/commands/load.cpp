// raynest load SOURCE: uploads the files that the daemon lacks and waits until the scene is built.
#include "client/arguments/shared_options.h"
#include "client/commands/command.h"
#include "client/files/files.h"
#include "client/ground/json.h"
#include "client/ground/numbers.h"
#include "client/ground/text.h"
#include "client/output/output.h"
#include "client/output/scene_text.h"
#include "client/requests/scene_source.h"
#include "protocol/subject.h"

#include <array>
#include <iostream>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

struct LoadOptions {
    std::string source, name, build, primitive, instances, variant;
    WorldPoint origin{};
    bool auto_origin = false;
    std::string up;
    double unit = 0, radius = 0, spacing = 0;  ///< 0: not given
    std::vector<std::string> masks;            ///< "GLOB=HEX"
    std::vector<std::string> share;            ///< principals, or "public"
    bool replace = false;
};

wire::LoadT load_message(const LoadOptions& options, const Upload& upload) {
    wire::LoadT load;
    load.name = options.name.empty() ? upload.scene_name : options.name;
    load.replace = options.replace;
    load.build = options.build;
    load.primitive = options.primitive;
    load.origin_x = options.origin[0];
    load.origin_y = options.origin[1];
    load.origin_z = options.origin[2];
    load.origin_auto = options.auto_origin;
    load.unit = options.unit;
    load.up = options.up;
    load.radius = options.radius;
    load.spacing = options.spacing;
    load.masks = options.masks;
    load.variant = options.variant;
    load.share = options.share;
    return load;
}

/// Reads mm, cm, m, in, ft or a number of metres; returns what is wrong, or "".
std::string read_unit(const std::string& text, double& unit) {
    constexpr std::array<std::pair<std::string_view, double>, 5> units{
        {{"mm", 0.001}, {"cm", 0.01}, {"m", 1}, {"in", 0.0254}, {"ft", 0.3048}}};
    for (const auto& [name, metres] : units) {
        if (text == name) unit = metres;
        if (text == name) return "";
    }
    const auto number = parse_world(text, 1, 1, "metres");
    if (!number || !((*number)[0] >= 1e-9 && (*number)[0] <= 1e9))
        return "'" + text + "' is none of mm, cm, m, in, ft, and no number of metres";
    unit = (*number)[0];
    return "";
}

void add_origin(CommandLine& line, LoadOptions& load) {
    line.add_parsed(
            "--origin",
            [&load](const std::string& text) -> std::string {
                load.auto_origin = text == "auto";
                if (load.auto_origin) return "";
                const auto numbers = parse_world(text, 3, 3, "x,y,z");
                if (!numbers) return numbers.error().message;
                load.origin = {(*numbers)[0], (*numbers)[1], (*numbers)[2]};
                return "";
            },
            "a point near a scene that lies far from zero; it is subtracted, so that coordinates "
            "keep their digits. Rays and answers stay in the world. auto chooses one for a file "
            "that is not glTF")
        .type_name("X,Y,Z");
}

}  // namespace

void declare(CommandLine& line, LoadOptions& load) {
    line.add_option(
            "SOURCE", load.source,
            "FILE.glb, .gltf, .rnscene.json, .obj, .ply, .stl, .off, .npz, .las, .tif or .npy; "
            "builtin:NAME[?key=value&...], root:PATH, or - for "
            "such a file on stdin, with --name")
        .required();
    line.add_option("--name", load.name,
                    "name of the scene (the file's stem; forest for builtin:forest?trees=5)");
    line.add_flag("--replace", load.replace,
                  "put it in the place of the scene of that name, as a new epoch");
    line.add_each(
            "--share",
            [&load](const std::string& list) -> Result<void> {
                const auto names = protocol::split_principals(list);
                if (!names) return fail(Exit::usage, names.error());
                load.share.insert(load.share.end(), names->begin(), names->end());
                return {};
            },
            "who else may use the scene: public, or principals as NAME,..., repeatable; '\\,' is a "
            "comma in a name, as in CN=robot\\,O=Lab (its owner alone)")
        .type_name("TEXT");
    line.add_option("--build", load.build,
                    "medium | fast | high: more time for the build makes faster trees");
    line.add_each(
        "--set-mask",
        [&load](const std::string& rule) {
            load.masks.push_back(rule);
            return check_mask_rule(rule);
        },
        "GLOB=HEX: the mask of placements whose path is GLOB or lies below it, where * stands for "
        "any text; may be repeated, the last match wins (see: query --mask)");
    line.add_option("--primitive", load.primitive,
                    "type of the records in a .npy: sphere, or one of a loaded pack; or heights: a "
                    "grid of shape (rows, columns)");
    line.add_option("--instances", load.instances,
                    "FILE.npy of shape (N, 3, 4): where the records of a .npy are placed");
    add_origin(line, load);
    line.add_parsed(
            "--unit", [&load](const std::string& text) { return read_unit(text, load.unit); },
            "unit of a file whose format has none (all but glTF): mm | cm | m | in | ft, or a "
            "number of metres (m)")
        .type_name("UNIT");
    line.add_option("--up", load.up,
                    "y | z: the axis of a file that points up. Coordinates stay as they are; the "
                    "default camera, the sky and its sun follow it (y, or what a .glb that RayNest "
                    "wrote says)");
    line.add_number(
        "--radius", load.radius, 1e-9, 1e9, "a length from 1e-9 to 1e9",
        "radius of the points of a .ply or .las, which become spheres, in the file's unit");
    line.add_number("--spacing", load.spacing, 1e-9, 1e9, "a length from 1e-9 to 1e9",
                    "distance between the heights of a grid, in the file's unit (1)");
    line.add_option("--variant", load.variant,
                    "name of a variant of a glTF file's materials (KHR_materials_variants), as "
                    "info lists them");
}

Result<void> run(Context& context, const LoadOptions& options) {
    context.progress.update(0, 0, "reading");
    const Result<Upload> upload = gather(options.source, options.primitive, options.instances);
    if (!upload) return tl::unexpected<Failure>(upload.error());
    if (options.name.empty() && upload->scene_name.empty() && !upload->files.empty())
        return fail(Exit::usage, "a scene of " + shown_name(options.source) +
                                     " has no name of its own; pass --name NAME");
    const auto loaded =
        load_scene(context.connection, context.progress, load_message(options, *upload), *upload);
    context.progress.clear();
    if (!loaded) return tl::unexpected<Failure>(loaded.error());

    const wire::SceneInfo& info = protocol::present((*loaded)->info());
    const double seconds = (*loaded)->seconds();
    if (context.json) {
        Json json = scene_json(info);
        json["seconds"] = seconds;
        json["reused"] = (*loaded)->reused();
        print_json(json);
    } else {
        print_scene(info);
        std::cout << ((*loaded)->reused() ? "was loaded already"
                                          : "loaded in " + seconds_text(seconds))
                  << '\n';
    }
    return {};
}

namespace {

class Load final : public CommandOf<LoadOptions> {
    [[nodiscard]] bool is_safe(const Failure& /*why*/) const override {
        return (options_.source.find(':') != std::string::npos || is_file(options_.source)) &&
               (options_.instances.empty() || is_file(options_.instances));
    }
};

}  // namespace

std::unique_ptr<Command> make_load() {
    return std::make_unique<Load>();
}

}  // namespace raynest::client

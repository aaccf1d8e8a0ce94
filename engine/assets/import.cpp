// How an import without a child process goes.
#include "engine/assets/import.h"

#include "engine/assets/composition/compose.h"
#include "engine/assets/formats/formats.h"
#include "engine/assets/formats/npy.h"
#include "engine/assets/gltf/gltf.h"
#include "engine/assets/input/mask_rules.h"
#include "engine/assets/input/messages.h"
#include "engine/assets/input/uploaded_files.h"

#include <fmt/format.h>

#include <exception>
#include <new>
#include <utility>

namespace raynest {
namespace {

/// Built-in scenes are described without a registry; their primitive types must still be loaded.
Result<SceneDescription> check_primitives(Result<SceneDescription> scene,
                                          const Registry& registry) {
    if (!scene) return scene;
    for (const ObjectDescription& object : scene->objects) {
        if (!object.record_type.empty() && registry.find_primitive(object.record_type) == nullptr) {
            return fail(ErrorCode::scene_unsupported,
                        fmt::format("the scene has primitives of type '{}', which no loaded "
                                    "kernel pack has",
                                    object.record_type));
        }
    }
    return scene;
}

/// Applies the masks of the request. glTF scenes apply them elsewhere (gltf/masks.h).
Result<SceneDescription> masked(const ImportRequest& request, Result<SceneDescription> scene) {
    if (!scene) return scene;
    auto rules = MaskRules::parse(request.masks);
    if (!rules) return tl::unexpected<Error>(rules.error());
    if (auto done = apply_masks(*rules, *scene); !done) return tl::unexpected<Error>(done.error());
    return scene;
}

/// Reads a format of the table, or a grid of heights.
Result<SceneDescription> describe_file(ReadFile read, const ImportRequest& request,
                                       const ImportLimits& limits, const Registry& registry) {
    if (request.options.auto_origin && request.origin != WorldPoint{})
        return fail(ErrorCode::scene_invalid, "takes an origin or one that is chosen, not both");
    auto content = read(request, limits);
    if (!content) return tl::unexpected<Error>(content.error());
    return masked(request, check_primitives(place(std::move(*content), request, limits), registry));
}

/// The word for a .npy of heights, in the place of a primitive type.
constexpr std::string_view heights = "heights";

double mebibytes(std::uint64_t bytes) {
    return static_cast<double>(bytes) / (1 << 20);
}

/// Prefixes an error with its scene: a user may load a dozen. Built-in scenes and arrays name
/// themselves.
Error named(const ImportRequest& request, Error error) {
    if (is_gltf(request.source) || is_composition(request.source) ||
        find_format(request.source) != nullptr)
        error.message = fmt::format("{}: {}", one_line(request.source), error.message);
    return error;
}

/// Refuses a request without the bytes of a file, or with too many of them.
Result<void> check_files(const ImportRequest& request, const ImportLimits& limits) {
    if (request.files.empty() || request.files.front().bytes.empty())
        return fail(ErrorCode::scene_invalid, "the scene file is empty");
    for (const NamedBytes& file : request.files) {
        if (file.bytes.size() > limits.file_bytes_max) {
            return fail(
                ErrorCode::limit_exceeded,
                fmt::format("'{}' has {} MiB; at most {} are allowed", file.name.substr(0, 200),
                            file.bytes.size() >> 20, limits.file_bytes_max >> 20));
        }
    }
    return {};
}

Result<BuiltArena> build_request(const ImportRequest& request, const ImportLimits& limits,
                                 const Registry& registry, DescribeBuiltin builtin) {
    if (is_composition(request.source)) {
        if (auto files = check_files(request, limits); !files) return tl::unexpected(files.error());
        return compose(request, limits, [&](const ImportRequest& file) {
            return import_arena(file, limits, registry, builtin);
        });
    }
    auto scene = describe(request, limits, registry, builtin);
    if (!scene) return tl::unexpected(scene.error());
    scene->build = request.build;
    return build_arena(*scene);
}

/// As describe(), but for the axis that the request says.
Result<SceneDescription> describe_source(const ImportRequest& request, const ImportLimits& limits,
                                         const Registry& registry, DescribeBuiltin builtin) {
    const std::string_view source = request.source;
    if (!is_origin(request.origin)) {
        return fail(ErrorCode::scene_invalid, "the origin is not finite, or lies beyond 1e15");
    }
    const bool is_npy = has_extension(source, ".npy");
    const FileFormat* const format = find_format(source);
    const bool takes_options = format != nullptr || (is_npy && request.primitive == heights);
    FileOptions others = request.options;
    others.z_up = false;
    if (!takes_options && others != FileOptions{}) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("`unit`, `radius`, `spacing` and an automatic origin are for {} "
                                "and a .npy of heights: leave them out",
                                format_list()));
    }
    if (!request.variant.empty() && !is_gltf(source))
        return fail(ErrorCode::scene_invalid,
                    "`variant` is for glTF files with KHR_materials_variants: leave it out");
    if (!request.mesh.empty() && !has_extension(source, ".npz"))
        return fail(ErrorCode::scene_invalid,
                    "'mesh' is for a .npz of several meshes: leave it out");
    if (source.starts_with("builtin:")) {
        if (request.origin != WorldPoint{}) {
            return fail(ErrorCode::scene_invalid,
                        "a built-in scene is centred on zero: only files take an origin");
        }
        if (request.options.z_up)
            return fail(ErrorCode::scene_invalid,
                        "y points up in a built-in scene: leave out `up`, or place it in a "
                        "composition with \"up\": \"z\"");
        if (builtin == nullptr)
            return fail(ErrorCode::scene_unsupported,
                        "this program imports files alone: pass describe_builtin() to have "
                        "built-in scenes");
        return masked(request, check_primitives(builtin(source), registry));
    }
    if (format != nullptr && format->read != read_tiff && request.options.spacing != 0)
        return fail(ErrorCode::scene_invalid,
                    "`spacing` lies between the heights of a grid: leave it out");
    if (auto files = check_files(request, limits); !files) return tl::unexpected(files.error());
    if (is_gltf(source)) return describe_gltf(request, limits);
    if (format != nullptr) return describe_file(format->read, request, limits, registry);
    if (is_npy && request.primitive == heights)
        return describe_file(read_heights, request, limits, registry);
    if (is_npy) return masked(request, describe_npy(request, limits, registry));
    return fail(
        ErrorCode::scene_unsupported,
        fmt::format("'{}' is not a scene that RayNest reads: .glb, .gltf, .rnscene.json, .npy, {}, "
                    "or builtin:forest, builtin:terrain, builtin:flake, builtin:street",
                    source.substr(0, 200), format_list()));
}

}  // namespace

Result<SceneDescription> describe(const ImportRequest& request, const ImportLimits& limits,
                                  const Registry& registry, DescribeBuiltin builtin) {
    auto scene = describe_source(request, limits, registry, builtin);
    if (scene && request.options.z_up) scene->up = UpAxis::z;
    if (scene && request.stands_at != WorldPoint{}) scene->origin = request.stands_at;
    return scene;
}

Result<BuiltArena> import_arena(const ImportRequest& request, const ImportLimits& limits,
                                const Registry& registry, DescribeBuiltin builtin) try {
    auto built = build_request(request, limits, registry, builtin);
    if (!built) return tl::unexpected<Error>(named(request, std::move(built.error())));
    if (const std::uint64_t bytes = built->arena.size(); bytes > limits.scene_bytes_max) {
        return fail(ErrorCode::out_of_memory,
                    fmt::format("the scene takes {:.1f} MiB, more than is free", mebibytes(bytes)));
    }
    return built;
} catch (const std::bad_alloc&) {
    return tl::unexpected<Error>(
        named(request,
              {ErrorCode::out_of_memory, "the scene needs more memory than an import may take"}));
} catch (const std::exception& error) {
    return fail(ErrorCode::internal, fmt::format("the import failed: {}", error.what()));
}

Result<std::shared_ptr<const Snapshot>> import_here(const ImportRequest& request,
                                                    const ImportLimits& limits,
                                                    const Registry& registry,
                                                    DescribeBuiltin builtin) {
    return import_arena(request, limits, registry, builtin).and_then(Snapshot::open);
}

}  // namespace raynest

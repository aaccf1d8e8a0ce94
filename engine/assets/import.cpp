// Which importer reads a source, and import without a child process.
#include "engine/assets/import.h"

#include "engine/assets/gltf.h"
#include "engine/assets/gltf_names.h"
#include "engine/assets/mask_rules.h"
#include "engine/assets/npy.h"

#include <fmt/format.h>

#include <exception>
#include <new>
#include <utility>

namespace raynest {
namespace {

/// Built-in scenes are described without a registry; what they are made of must still be loaded.
Result<SceneDescription> check_primitives(Result<SceneDescription> scene,
                                          const Registry& registry) {
    if (!scene) return scene;
    for (const ObjectDescription& object : scene->objects) {
        if (!object.record_type.empty() && registry.find_primitive(object.record_type) == nullptr) {
            return fail(ErrorCode::scene_unsupported,
                        fmt::format("the scene is made of primitives of type '{}', which no loaded "
                                    "kernel pack has",
                                    object.record_type));
        }
    }
    return scene;
}

/// With the masks of the request; glTF has its own way (gltf_masks.h).
Result<SceneDescription> masked(const ImportRequest& request, Result<SceneDescription> scene) {
    if (!scene) return scene;
    auto rules = MaskRules::parse(request.masks);
    if (!rules) return tl::unexpected<Error>(rules.error());
    if (auto done = apply_masks(*rules, *scene); !done) return tl::unexpected<Error>(done.error());
    return scene;
}

bool is_gltf(std::string_view source) {
    return has_extension(source, ".glb") || has_extension(source, ".gltf");
}

/// Who loads a dozen scenes wants to know which one it was. Built-in scenes and arrays name
/// themselves.
Error named(const ImportRequest& request, Error error) {
    if (is_gltf(request.source))
        error.message = fmt::format("{}: {}", gltf::one_line(request.source), error.message);
    return error;
}

}  // namespace

Result<SceneDescription> describe(const ImportRequest& request, const ImportLimits& limits,
                                  const Registry& registry) {
    const std::string_view source = request.source;
    if (!is_origin(request.origin)) {
        return fail(ErrorCode::scene_invalid, "the origin is not finite, or lies beyond 1e15");
    }
    if (source.starts_with("builtin:")) {
        if (request.origin != WorldPoint{}) {
            return fail(ErrorCode::scene_invalid,
                        "a built-in scene lies around zero: only files take an origin");
        }
        return masked(request, check_primitives(describe_builtin(source), registry));
    }
    if (request.files.empty() || request.files.front().bytes.empty()) {
        return fail(ErrorCode::scene_invalid, "the scene file is empty");
    }
    for (const NamedBytes& file : request.files) {
        if (file.bytes.size() > limits.file_bytes_max) {
            return fail(
                ErrorCode::limit_exceeded,
                fmt::format("'{}' has {} MiB; at most {} are allowed", file.name.substr(0, 200),
                            file.bytes.size() >> 20, limits.file_bytes_max >> 20));
        }
    }
    if (is_gltf(source)) return describe_gltf(request, limits);
    if (has_extension(source, ".npy"))
        return masked(request, describe_npy(request, limits, registry));
    return fail(
        ErrorCode::scene_unsupported,
        fmt::format("'{}' is not a scene that RayNest reads: .glb, .gltf, .npy, or builtin:forest, "
                    "builtin:terrain, builtin:flake",
                    source.substr(0, 200)));
}

Result<std::shared_ptr<const Snapshot>> import_here(const ImportRequest& request,
                                                    const ImportLimits& limits,
                                                    const Registry& registry) try {
    auto scene = describe(request, limits, registry);
    if (!scene) return tl::unexpected<Error>(named(request, std::move(scene.error())));
    scene->build = request.build;
    auto snapshot = Snapshot::bake(*scene);
    if (!snapshot) return tl::unexpected<Error>(named(request, std::move(snapshot.error())));
    if (const std::uint64_t bytes = (*snapshot)->bytes().size(); bytes > limits.scene_bytes_max) {
        return fail(ErrorCode::out_of_memory,
                    fmt::format("the scene takes {} bytes, {} are free: unload another, or start "
                                "raynestd with a larger --memory",
                                bytes, limits.scene_bytes_max));
    }
    return snapshot;
} catch (const std::bad_alloc&) {
    return tl::unexpected<Error>(
        named(request, {ErrorCode::out_of_memory,
                        "the scene needs more memory than an import may take; "
                        "start raynestd with a larger --memory"}));
} catch (const std::exception& error) {
    return fail(ErrorCode::internal, fmt::format("the import failed: {}", error.what()));
}

}  // namespace raynest

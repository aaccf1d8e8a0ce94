// Describes a scene file in a test: a helper each for success and for refusal.
#pragma once

#include "engine/assets/gltf/gltf.h"
#include "tests/unit/engine/assets/samples.h"

#include <string>

namespace raynest::test {

inline Result<SceneDescription> describe(const Bytes& bytes,
                                         const std::string& name = "scene.glb") {
    const Upload upload(name, bytes);
    return describe_gltf(upload.request(), ImportLimits{});
}

inline SceneDescription must_describe(const Result<SceneDescription>& scene) {
    REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    return *scene;
}
inline SceneDescription must_describe(const Bytes& bytes, const std::string& name = "scene.glb") {
    return must_describe(describe(bytes, name));
}

inline std::string refusal(const Bytes& bytes, const std::string& name = "scene.glb") {
    const auto scene = describe(bytes, name);
    REQUIRE_FALSE(scene.has_value());
    CHECK(scene.error().message.find('\n') == std::string::npos);
    return scene.error().message;
}

inline bool contains(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

/// Describes a file of ../shared/scenes with the other files of its folder.
inline SceneDescription must_describe_shared(const std::string& name) {
    const Upload upload(shared_scene(name));
    return must_describe(describe_gltf(upload.request(), ImportLimits{}));
}

}  // namespace raynest::test

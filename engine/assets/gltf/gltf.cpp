// .glb and .gltf -> SceneDescription: runs the guards in order, then the readers.
#include "engine/assets/gltf/gltf.h"

#include "engine/assets/gltf/describe.h"
#include "engine/assets/gltf/file/prescan.h"
#include "engine/assets/gltf/precision.h"
#include "engine/assets/gltf/skins.h"
#include "engine/assets/images/image.h"
#include "engine/assets/input/uploaded_files.h"

#include <fmt/format.h>

#include <optional>
#include <thread>

namespace raynest {
namespace {

bool contains(std::span<const std::byte> text, std::string_view word) {
    return std::string_view(reinterpret_cast<const char*>(text.data()), text.size()).find(word) !=
           std::string_view::npos;
}

}  // namespace

Result<SceneDescription> describe_gltf(const ImportRequest& request, const ImportLimits& limits) {
    const std::span<const std::byte> main = request.files.front().bytes;
    const bool is_glb = gltf::starts_as_glb(main) || has_extension(request.source, ".glb");
    gltf::Glb text{main, {}};
    if (is_glb) {
        const auto glb = gltf::open_glb(main);
        if (!glb) return gltf::error_of(glb);
        text = *glb;
    }
    // To load the image module takes about as long as to read the rest of a small scene.
    std::optional<std::jthread> loading;
    if (contains(text.json, "\"images\"")) loading.emplace([] { (void)images_available(); });
    const auto prescan = gltf::prescan_json(text.json, limits);
    if (!prescan) return gltf::error_of(prescan);
    auto model = gltf::load_model(request, text, *prescan);
    if (!model) return gltf::error_of(model);
    gltf::separate_poses(*model);
    gltf::move_world(*model, request.origin);
    auto rules = MaskRules::parse(request.masks);
    if (!rules) return gltf::error_of(rules);

    SceneDescription scene;
    scene.origin = request.origin;
    scene.up = model->up;
    scene.warnings = model->warnings;
    scene.variants = model->variants;
    scene.chosen_variant = model->chosen_variant;
    if (auto done = gltf::read_nodes(*model, limits, *rules, scene); !done)
        return gltf::error_of(done);
    loading.reset();
    if (auto done = gltf::read_materials(*model, limits, scene); !done) return gltf::error_of(done);
    if (model->hidden_instances != 0) scene.skipped["hidden_instances"] = model->hidden_instances;
    for (const char* shape : {"points", "lines"}) {
        if (const auto found = scene.skipped.find(shape); found != scene.skipped.end()) {
            scene.warnings.push_back(fmt::format(
                "{} of {} left out: rays hit triangles, and points that have a _RADIUS",
                found->second == 1 ? "1 primitive" : fmt::format("{} primitives", found->second),
                shape));
        }
    }
    return scene;
}

}  // namespace raynest

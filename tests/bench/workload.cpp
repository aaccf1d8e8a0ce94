#include "tests/bench/workload.h"

#include "engine/assets/builtin/builtin.h"
#include "engine/assets/import.h"
#include "tests/bench/files.h"

#include <filesystem>
#include <utility>

namespace raynest::bench {
namespace {

Result<Generated> without_light(Result<SceneDescription> scene) {
    return std::move(scene).map([](SceneDescription&& description) {
        return Generated{std::move(description), std::nullopt};
    });
}

Result<Generated> describe_source(const std::string& source, const Registry& registry) {
    if (source.starts_with("gen:")) return generate(source);
    if (source.ends_with(".soup")) return without_light(read_soup(source));
    if (source.ends_with(".inst")) return without_light(read_instances(source));
    ImportRequest request;
    request.source = source;
    std::vector<std::byte> main_file;
    if (!source.starts_with("builtin:")) {
        auto bytes = read_file(source);
        if (!bytes) return tl::unexpected(bytes.error());
        main_file = std::move(*bytes);
        request.source = std::filesystem::path(source).filename();
        request.files.push_back({request.source, main_file});
    }
    return without_light(describe(request, ImportLimits{}, registry, describe_builtin));
}

/// "gen:cards?scale=0.1" -> "cards", "dir/temple.glb" -> "temple".
std::string short_name(const std::string& source) {
    const std::string stem = std::filesystem::path(source.substr(0, source.find('?'))).stem();
    return stem.substr(stem.find(':') + 1);
}

}  // namespace

Result<Workload> load_workload(const std::string& source, const Registry& registry) {
    auto described = describe_source(source, registry);
    if (!described) return tl::unexpected(described.error());
    auto scene = Snapshot::build(described->scene);
    if (!scene) return tl::unexpected(scene.error());
    return Workload{short_name(source), std::move(described->scene), *scene, described->light};
}

}  // namespace raynest::bench

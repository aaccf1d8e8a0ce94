#include "engine/integrators/target_module.h"

#include "engine/packs/load.h"
#include "engine/packs/registry.h"

#include <map>
#include <mutex>
#include <string>

namespace raynest {
namespace {

Result<const IntegratorCode*> load_code(const std::string& target) {
    const std::filesystem::path path =
        builtin_pack_directory() / "shading" / ("raynest-shading-" + target + ".so");
    std::error_code error;
    if (!std::filesystem::exists(path, error)) return nullptr;
    const auto entry = load_symbol(path, integrator_symbol);
    if (!entry) return tl::unexpected(entry.error());
    const IntegratorCode* const code = reinterpret_cast<IntegratorEntry>(*entry)();
    if (code->types != integrator_types())
        return fail(ErrorCode::pack_invalid, path.string() +
                                                 " was built against other engine headers: build "
                                                 "the target raynest_packs");
    return code;
}

}  // namespace

Result<const IntegratorCode*> integrator_code(std::string_view target) {
    static std::mutex mutex;
    static std::map<std::string, const IntegratorCode*, std::less<>> loaded;
    const std::lock_guard lock(mutex);
    if (const auto known = loaded.find(target); known != loaded.end()) return known->second;
    auto code = load_code(std::string(target));
    if (code) loaded.emplace(target, *code);
    return code;
}

Result<std::unique_ptr<const Integrator>> make_integrator(std::string_view name,
                                                          const IntegratorScene& scene,
                                                          const IntegratorSettings& settings) {
    if (scene.target.empty()) return make_from_list(name, scene, settings);
    const auto code = integrator_code(scene.target);
    if (!code) return tl::unexpected(code.error());
    return *code != nullptr ? (*code)->make(name, scene, settings)
                            : make_from_list(name, scene, settings);
}

}  // namespace raynest

// Integrators compiled for one CPU target: a module per target, in the folder shading/ beside the
// kernel packs.
//
// A module holds this folder's integrators and engine/shading with the flags of the target's
// kernels, but without fused arithmetic, so that all targets and the library's own code, the
// baseline, give the same bytes. Each is a module of its own for the reason that packs are: a
// linker merges inline functions that were compiled for different CPUs.
#pragma once

#include "engine/integrators/integrator.h"

#include <cstdint>
#include <initializer_list>

namespace raynest {

/// Exported by a module, by the symbol below. Both sides are C++ of one build.
struct IntegratorCode {
    std::uint64_t types;  ///< integrator_types(), read before the rest
    Result<std::unique_ptr<const Integrator>> (*make)(std::string_view name,
                                                      const IntegratorScene& scene,
                                                      const IntegratorSettings& settings);
};
inline constexpr const char* integrator_symbol = "raynest_integrators";
using IntegratorEntry = const IntegratorCode* (*)() noexcept;

/// Changes with the sizes of the types that cross the border; increment the first number where
/// their meaning changes.
[[nodiscard]] constexpr std::uint64_t integrator_types() {
    std::uint64_t hash = 1;
    for (const std::size_t size :
         {sizeof(IntegratorScene), sizeof(IntegratorSettings), sizeof(SampleRange),
          sizeof(Wavefront), sizeof(Integrator), sizeof(Film), sizeof(FilmSample), sizeof(Sensor),
          sizeof(Ray), sizeof(HitRecord), sizeof(SceneView), sizeof(ShadingView),
          sizeof(SurfaceRecord), sizeof(LightRecord), sizeof(ObjectRecord), sizeof(GeometryRecord),
          sizeof(MaterialRecord), sizeof(TextureRecord)})
        hash = (hash ^ size) * 1099511628211U;
    return hash;
}

/// The code for a target of packs/pack.cmake, which this CPU must run; null where there is no
/// module for it. Loaded once, for the life of the process. Any thread.
Result<const IntegratorCode*> integrator_code(std::string_view target);

/// An integrator of the list by the code that this function is compiled into.
Result<std::unique_ptr<const Integrator>> make_from_list(std::string_view name,
                                                         const IntegratorScene& scene,
                                                         const IntegratorSettings& settings);

}  // namespace raynest

// The reflectance of a surface below a thin film, whose two borders reflect waves that add up or
// cancel, by wavelength (Belcour and Barla, "A Practical Extension to Microfacet Theory for the
// Modeling of Varying Iridescence", 2017; as KHR_materials_iridescence asks).
#pragma once

#include "engine/shading/ggx.h"

namespace raynest {

/// The reflectance along the normal with which Schlick's term gives what a film of this index and
/// thickness (in nanometres, in air) above a surface of reflectance `f0` reflects at this cosine.
[[nodiscard]] Vec3 iridescent_f0(float cosine, float film_ior, float thickness, const Vec3& f0);

}  // namespace raynest

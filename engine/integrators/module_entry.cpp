// The entry of a module of integrators for one CPU target (integrators/target_module.h).
#include "engine/integrators/target_module.h"

extern "C" [[gnu::visibility("default")]] const raynest::IntegratorCode*
raynest_integrators() noexcept {
    static constexpr raynest::IntegratorCode code{raynest::integrator_types(),
                                                  raynest::make_from_list};
    return &code;
}

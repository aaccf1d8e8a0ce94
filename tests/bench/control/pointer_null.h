// The price of being able to ask: a null pointer that is checked.
#pragma once

#include "tests/bench/control/pointer.h"

namespace raynest {

struct PointerNull : PointerTested {
    static constexpr const char* text = "control: a null pointer is checked at run time";
    struct Params {};
    static constexpr auto params = std::tuple{};
    PointerNull(const SceneView& scene, const Params&) : PointerTested(none, &scene) {}

private:
    static inline constinit SurfaceTest volatile none = nullptr;
};

}  // namespace raynest

// The price of asking: a function is called that accepts everything.
#pragma once

#include "tests/bench/control/pointer.h"

namespace raynest {

struct PointerNoop : PointerTested {
    static constexpr const char* text = "control: a live pointer to a test that accepts all";
    struct Params {};
    static constexpr auto params = std::tuple{};
    PointerNoop(const SceneView& scene, const Params&) : PointerTested(accept, &scene) {}

private:
    static bool accept_all(const void*, const ObjectRecord*, const Surface&) { return true; }
    static inline constinit SurfaceTest volatile accept = accept_all;
};

}  // namespace raynest

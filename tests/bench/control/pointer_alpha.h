// The alpha test behind a live pointer.
#pragma once

#include "tests/bench/control/alpha_test.h"
#include "tests/bench/control/pointer.h"

namespace raynest {

struct PointerAlpha : PointerTested {
    static constexpr const char* text = "control: the alpha test through a live pointer";
    struct Params {};
    static constexpr auto params = std::tuple{};
    PointerAlpha(const SceneView& scene, const Params&) : PointerTested(alpha, &scene) {}

private:
    static bool call(const void* context, const ObjectRecord* object, const Surface& surface) {
        return passes_alpha(*static_cast<const SceneView*>(context), *object, surface);
    }
    static inline constinit SurfaceTest volatile alpha = call;
};

}  // namespace raynest

// Every surface stops the ray.
#pragma once

namespace raynest {

/// Overrides nothing: no cost by construction. The default intersector of every query.
struct Opaque {
    static constexpr const char* text = "every surface stops the ray";
};

}  // namespace raynest

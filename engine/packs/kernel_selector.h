// The compiled functions of one request, and which of them a chunk of rays goes through.
//
// All traversals give the same bytes, so the choice is free to look at the rays.
#pragma once

#include "engine/packs/registry.h"

#include <array>
#include <span>

namespace raynest {

/// Immutable once made; safe to use from many threads.
class KernelSelector {
public:
    /// For a traversal that was named, that one; for traversal_auto all that were compiled.
    /// Counters are defined by the single traversal, and so are an intersector's outputs (what
    /// they count may depend on the order of the questions): with either it is the only one. Fails
    /// with variant_unknown where nothing fits.
    static Result<KernelSelector> make(const Variant& variant, Query query, Traversal traversal,
                                       CounterMode counters = counters_none);

    /// The single traversal with an observer (TraceCall::observer).
    static Result<KernelSelector> observing(const Variant& variant);

    /// Chooses for rays that lie next to each other in a request: `packet` where most
    /// of a sample of 64-ray groups look the same way from the same place (`single` if that is not
    /// compiled: coherent rays wait for little), else `stream` where the scene's trees do not fit a
    /// core's cache, else `single`, as for fewer rays than a group.
    [[nodiscard]] Traversal choose(std::span<const Ray> rays, const SceneView& scene) const;

    [[nodiscard]] TraceFunction function(Traversal traversal) const {
        return functions_[traversal];
    }

private:
    Traversal named_ = traversal_single;  ///< or traversal_auto: open
    std::array<TraceFunction, traversal_count> functions_{};
};

}  // namespace raynest

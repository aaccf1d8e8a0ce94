// An intersector compiled for a target. packs/pack.cmake compiles this file once per intersector of
// the list and target, with the intersector's type, header and declared overrides as definitions.
#include "engine/packs/variant.h"

#include RAYNEST_INTERSECTOR_HEADER
#include "engine/intersectors/check.h"

namespace raynest {

static_assert(HWY_STATIC_TARGET == RAYNEST_HIGHWAY_TARGET,
              "Highway chose another instruction set than this pack's flags ask for");
static_assert(check_intersector<RAYNEST_INTERSECTOR_TYPE,
                                Declared{.boxes = RAYNEST_OVERRIDES_BOXES,
                                         .primitives = RAYNEST_OVERRIDES_PRIMITIVES,
                                         .instances = RAYNEST_OVERRIDES_INSTANCES}>());

/// Named RAYNEST_VARIANT_<name>; pack.cpp collects them.
const PackVariant& RAYNEST_INTERSECTOR_FUNCTION() noexcept {
    static constexpr PackVariant variant =
        make_variant<RAYNEST_INTERSECTOR_TYPE>(RAYNEST_INTERSECTOR_NAME);
    return variant;
}

}  // namespace raynest

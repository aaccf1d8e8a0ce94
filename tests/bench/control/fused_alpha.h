// alpha_mask as it is, in the control pack: the same compiler run as what it is compared with.
#pragma once

#include "engine/intersectors/alpha_mask.h"

namespace raynest {

struct FusedAlpha : AlphaMask {
    static constexpr const char* text = "control: the alpha test compiled in";
    using AlphaMask::AlphaMask;
};

}  // namespace raynest

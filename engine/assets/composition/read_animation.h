// The animations of a composition, as its text says them.
#pragma once

#include "engine/assets/composition/read.h"
#include "engine/assets/composition/value.h"

namespace raynest::composition {

/// Throws Refusal for what is no animation.
Animation read_animation(const Value& value);

}  // namespace raynest::composition

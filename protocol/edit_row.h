// A row of EDIT, as it travels in the request's file (PROTOCOL.md, "Edit").
#pragma once

#include <cstdint>

namespace raynest::protocol {

struct EditRow {
    /// place: from the object's space to the world. move: on top of where it stands, in the world.
    enum What : std::uint32_t { place, move, set_mask, what_count };
    std::uint32_t what;
    std::uint32_t target;   ///< an outermost instance, or an index in the request's `targets`
    std::uint32_t by_text;  ///< 1: in `targets`
    std::uint32_t mask;     ///< of set_mask
    double m[12];           ///< of the others: a 3x4 matrix, row by row
};
static_assert(sizeof(EditRow) == 112);

}  // namespace raynest::protocol

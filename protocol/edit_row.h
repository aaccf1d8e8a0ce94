// A row of EDIT, as it travels in the request's file (PROTOCOL.md, "Edit").
#pragma once

#include <cstdint>

namespace raynest::protocol {

struct EditRow {
    /// place: to where the matrix says. move: on top of where it stands. add: a placement of
    /// another scene, to the world. vertices: where those of its mesh, and its normals, are from now
    /// on.
    enum What : std::uint32_t {
        place,
        move,
        set_mask,
        remove,
        add,
        vertices,
        set_uid,
        set_material,
        what_count
    };
    enum Frame : std::uint32_t { world, parent, own, frame_count };
    /// Says what `target` is: an outermost instance, an index in `targets`, a user id.
    enum By : std::uint32_t { number, text, uid, by_count };
    std::uint32_t what;
    std::uint32_t target;  ///< for add: an index in `scenes`
    std::uint32_t by;
    /// The mask of set_mask and add, the frame of place and move, the user id of set_uid; of
    /// set_material an index in `materials`, of vertices one in `vertex_counts`
    std::uint32_t value;
    double m[12];  ///< for place, move and add: a 3x4 matrix, row by row
};
static_assert(sizeof(EditRow) == 112);

}  // namespace raynest::protocol

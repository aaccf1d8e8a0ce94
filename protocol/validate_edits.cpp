// Checks of the messages that change a scene or pin it (validate.h).
#include "protocol/checks.h"
#include "protocol/validate.h"

#include <cstdint>

namespace raynest::protocol {
namespace {

using Counts = flatbuffers::Vector<std::uint32_t>;

/// True if each mesh has a normal for each of its vertices, or none.
bool fit(const Counts* vertices, const Counts* normals) {
    if (normals == nullptr || normals->size() == 0) return true;
    if (vertices == nullptr || vertices->size() != normals->size()) return false;
    for (std::uint32_t i = 0; i < normals->size(); ++i)
        if (normals->Get(i) != 0 && normals->Get(i) != vertices->Get(i)) return false;
    return true;
}

}  // namespace

Result<void> validate(const wire::Edit& message, const Limits& limits) {
    std::uint64_t vertices = 0;
    if (message.vertex_counts() != nullptr)
        for (const std::uint32_t count : *message.vertex_counts()) vertices += count;
    return Checks(limits)
        .named("scene", message.scene())
        .texts("targets", message.targets())
        .names("scenes", message.scenes())
        .texts("names", message.names())
        .texts("materials", message.materials())
        .aligned("vertex_counts", message.vertex_counts(), limits.list_items_max, "list_items_max")
        .at_most("vertex_counts", vertices, limits.edit_vertices_max, "edit_vertices_max")
        .aligned("normal_counts", message.normal_counts(), limits.list_items_max, "list_items_max")
        .that(fit(message.vertex_counts(), message.normal_counts()), "normal_counts",
              "must have 0 or as many normals for each of vertex_counts")
        .at_least("rows", message.rows(), 1)
        .at_most("rows", message.rows(), limits.edit_rows_max, "edit_rows_max")
        .result();
}

Result<void> validate(const wire::Edited& message, const Limits& limits) {
    return Checks(limits).name("hash", message.hash()).texts("notes", message.notes()).result();
}

Result<void> validate(const wire::Pin& message, const Limits& limits) {
    return Checks(limits).named("scene", message.scene()).result();
}

Result<void> validate(const wire::Pinned& message, const Limits& limits) {
    return Checks(limits).text("name", message.name()).result();
}

}  // namespace raynest::protocol

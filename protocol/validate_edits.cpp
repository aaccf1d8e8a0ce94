// Checks of the messages that change a scene or pin it (validate.h).
#include "protocol/checks.h"
#include "protocol/validate.h"

namespace raynest::protocol {

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

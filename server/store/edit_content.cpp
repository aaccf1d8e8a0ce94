#include "server/store/edit_content.h"

#include "protocol/control.h"

#include <algorithm>
#include <cstring>

namespace raynest::server {

std::uint64_t EditContent::bytes() const {
    std::uint64_t sum = std::uint64_t{rows} * sizeof(EditRow);
    for (const auto& counts : {vertex_counts, normal_counts})
        for (const std::uint32_t count : counts) sum += std::uint64_t{count} * sizeof(Vec3);
    return sum;
}

EditContent edit_content(const wire::Edit& message) {
    EditContent content;
    content.targets = protocol::strings(message.targets());
    content.rows = message.rows();
    content.materials = protocol::strings(message.materials());
    if (const auto* counts = message.vertex_counts())
        content.vertex_counts.assign(counts->begin(), counts->end());
    if (const auto* counts = message.normal_counts())
        content.normal_counts.assign(counts->begin(), counts->end());
    return content;
}

// A kept change is an EDIT message, its length before it in 8 bytes, and the rows and vertices
// behind it.

Reply<std::vector<std::byte>> kept_change(const EditContent& content,
                                          std::span<const std::byte> bytes) {
    wire::EditT message;
    message.scene = "kept";
    message.targets = content.targets;
    message.rows = content.rows;
    message.vertex_counts = content.vertex_counts;
    message.normal_counts = content.normal_counts;
    message.materials = content.materials;
    const auto frame = protocol::encode(0, message);
    if (!frame) return tl::unexpected(frame.error());
    const auto& control = frame->control;
    const std::uint64_t size = control.size();
    std::vector<std::byte> change;
    change.reserve(sizeof size + size + bytes.size());
    const auto head = std::as_bytes(std::span(&size, 1));
    change.insert(change.end(), head.begin(), head.end());
    change.insert(change.end(), control.data(), control.data() + size);
    change.insert(change.end(), bytes.begin(), bytes.end());
    return change;
}

Reply<KeptChange> read_change(const KeptEdit& edit) {
    const auto damaged = [](const std::string& why) { return refuse(Code::scene_invalid, why); };
    std::uint64_t size = 0;
    if (edit.change.size() < sizeof size) return damaged("is cut");
    std::memcpy(&size, edit.change.data(), sizeof size);
    if (size > edit.change.size() - sizeof size) return damaged("is cut");
    protocol::Frame frame;
    frame.header.type = static_cast<std::uint16_t>(protocol::message_of<wire::Edit>);
    const auto control = std::span(edit.change).subspan(sizeof size, size);
    frame.control = protocol::Buffer(size);
    std::ranges::copy(control, frame.control.data());
    const auto message = protocol::open<wire::Edit>(frame);
    if (!message) return damaged("cannot be read: " + message.error().message);
    const auto rest = std::span(edit.change).subspan(sizeof size + size);
    KeptChange change{edit_content(*message->table), {rest.begin(), rest.end()}};
    if (rest.size() != change.content.bytes()) return damaged("is cut");
    return change;
}

}  // namespace raynest::server

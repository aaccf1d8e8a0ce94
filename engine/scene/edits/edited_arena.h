// The parts of an arena that refitting edits change, and which bytes they have changed.
#pragma once

#include "engine/scene/format.h"
#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

namespace raynest {

/// A copy of a scene's arena. Not thread-safe, but different elements may be written by different
/// threads.
class EditedArena {
public:
    EditedArena(Arena arena, const SceneView& before) : arena_(std::move(arena)), view_(before) {
        view_.nodes = section<Node>(format::Section::nodes);
        view_.objects = section<ObjectRecord>(format::Section::objects);
        view_.instances = section<InstanceRecord>(format::Section::instances);
        view_.instance_infos = section<InstanceInfo>(format::Section::instance_infos);
    }

    [[nodiscard]] const SceneView& view() const { return view_; }
    [[nodiscard]] ObjectRecord& object(std::uint32_t index) {
        return section<ObjectRecord>(format::Section::objects)[index];
    }
    [[nodiscard]] std::span<Node> nodes(const ObjectRecord& object) {
        return {section<Node>(format::Section::nodes) + object.first_node, object.node_count};
    }
    /// By the index in SceneView::instances.
    [[nodiscard]] InstanceRecord& instance(std::uint32_t index) {
        return section<InstanceRecord>(format::Section::instances)[index];
    }
    [[nodiscard]] InstanceInfo& info(std::uint32_t index) {
        return section<InstanceInfo>(format::Section::instance_infos)[index];
    }
    void set_bounds(const Box& bounds) {
        Box& place = reinterpret_cast<format::Header*>(arena_.data())->bounds;
        place = bounds;
        touch(place);
    }
    [[nodiscard]] Arena take() { return std::move(arena_); }

    /// Notes that an element has changed.
    template <class T>
    void touch(const T& element) {
        const auto first =
            static_cast<std::size_t>(reinterpret_cast<const std::byte*>(&element) - arena_.data());
        changed_[first / digest_piece_bytes] = true;
        changed_[(first + sizeof(T) - 1) / digest_piece_bytes] = true;
    }
    /// The pieces that have changed (scene/digest.h).
    [[nodiscard]] const std::vector<bool>& changed() const { return changed_; }

private:
    template <class T>
    T* section(format::Section which) {
        return const_cast<T*>(format::section<T>(arena_.data(), which));
    }

    Arena arena_;
    SceneView view_;
    std::vector<bool> changed_{
        std::vector<bool>((arena_.size() + digest_piece_bytes - 1) / digest_piece_bytes)};
};

}  // namespace raynest

// The parts of an arena that refitting edits change, and which pages they have changed.
#pragma once

#include "engine/scene/format.h"
#include "engine/scene/page_set.h"
#include "engine/scene/snapshot.h"

#include <algorithm>
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
        view_.blocks = section<TriangleBlock>(format::Section::blocks);
        view_.geometries = section<GeometryRecord>(format::Section::geometries);
        view_.cameras = section<CameraRecord>(format::Section::cameras);
        view_.attributes = section<std::byte>(format::Section::attributes);
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
    [[nodiscard]] std::span<TriangleBlock> blocks(const ObjectRecord& object) {
        return {section<TriangleBlock>(format::Section::blocks) + object.first_block,
                object.block_count};
    }
    [[nodiscard]] GeometryRecord& geometry(std::uint32_t index) {
        return section<GeometryRecord>(format::Section::geometries)[index];
    }
    [[nodiscard]] const GeometryShading& geometry_shading(std::uint32_t geometry) {
        return section<GeometryShading>(format::Section::geometry_shading)[geometry];
    }
    /// A run of attributes, by its offset.
    template <class T>
    [[nodiscard]] std::span<T> attribute(std::uint64_t offset, std::size_t count) {
        return {reinterpret_cast<T*>(section<std::byte>(format::Section::attributes) + offset),
                count};
    }
    void set_camera(std::uint32_t index, const Transform& to_world) {
        CameraRecord& camera = section<CameraRecord>(format::Section::cameras)[index];
        camera.to_world = to_world;
        touch(camera);
    }
    void set_light(std::uint32_t index, const Vec3& position, const Vec3& direction) {
        LightRecord& light = section<LightRecord>(format::Section::lights)[index];
        light.position = position;
        light.direction = direction;
        touch(light);
    }
    void set_bounds(const Box& bounds) {
        header().bounds = bounds;
        touch(header().bounds);
    }
    void add_degenerate(std::int64_t more) {
        header().degenerate_triangles += static_cast<std::uint64_t>(more);
        touch(header().degenerate_triangles);
    }
    [[nodiscard]] Arena take() { return std::move(arena_); }

    /// Notes that an element has changed.
    template <class T>
    void touch(const T& element) {
        touch_all(std::span(&element, 1));
    }
    template <class T>
    void touch_all(std::span<T> elements) {
        if (elements.empty()) return;
        const auto first = static_cast<std::size_t>(
            reinterpret_cast<const std::byte*>(elements.data()) - arena_.data());
        changed_.pages.add(first, first + elements.size_bytes() - 1);
        changed_.sections |= section_bit(first);
    }
    [[nodiscard]] const ArenaChanges& changed() const { return changed_; }

private:
    format::Header& header() { return *reinterpret_cast<format::Header*>(arena_.data()); }
    /// Returns the bit of the section at this offset, 0 for the header. Of sections that begin
    /// there all but the last are empty.
    std::uint32_t section_bit(std::size_t offset) {
        static_assert(format::section_count <= 32);
        const auto& sections = header().sections;
        const auto behind =
            std::ranges::upper_bound(sections, offset, {}, &format::SectionEntry::offset);
        return behind == sections.begin() ? 0 : 1U << (behind - sections.begin() - 1);
    }
    template <class T>
    T* section(format::Section which) {
        return const_cast<T*>(format::section<T>(arena_.data(), which));
    }

    Arena arena_;
    SceneView view_;
    ArenaChanges changed_{PageSet(arena_.size())};
};

}  // namespace raynest

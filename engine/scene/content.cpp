#include "engine/scene/content.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstring>

namespace raynest {
namespace {

using format::Section;

/// Alignment of a run, because SIMD loads may read whole runs.
constexpr std::uint64_t attribute_alignment = 16;

/// Lanes of leaf blocks that one task fills.
constexpr std::size_t blocks_part = 1U << 15;
/// Triangles whose corners one task copies.
constexpr std::size_t triangles_part = 1U << 12;

}  // namespace

void write_blocks(const ObjectDescription& object, const Tree& tree,
                  std::span<const GeometryRecord> geometries, const MaterialRecord* materials,
                  TriangleBlock* blocks, TexcoordBlock* texcoords) {
    const auto geometry_of = [&](std::uint32_t triangle) {
        const auto next = std::upper_bound(
            geometries.begin(), geometries.end(), triangle,
            [](std::uint32_t t, const GeometryRecord& g) { return t < g.first_triangle; });
        return static_cast<std::size_t>(next - geometries.begin()) - 1;
    };
    using Part = tbb::blocked_range<std::size_t>;
    tbb::parallel_for(Part(0, tree.block_lanes.size(), blocks_part), [&](const Part& part) {
        std::size_t geometry = 0;
        for (std::size_t i = part.begin(); i < part.end(); ++i) {
            TriangleBlock& block = blocks[i / 8];
            const std::size_t lane = i % 8;
            const std::uint32_t triangle = tree.block_lanes[i];
            block.triangle[lane] = triangle;
            if (triangle == no_id) continue;  // the arena is zero-filled: three equal vertices

            // Try the last geometry first: neighbours in the tree mostly share it.
            const GeometryRecord& last = geometries[geometry];
            if (triangle - last.first_triangle >= last.triangle_count) {
                geometry = geometry_of(triangle);
            }
            const GeometryDescription& source = object.geometries[geometry];
            const std::size_t first = triangle - geometries[geometry].first_triangle;
            for (std::size_t corner = 0; corner < 3; ++corner) {
                const Vec3& p = source.positions[source.indices[3 * first + corner]];
                for (int axis = 0; axis < 3; ++axis) {
                    block.vertex[corner][axis][lane] = p[axis];
                }
            }
            if (texcoords != nullptr && has_alpha_texture(geometries[geometry], materials)) {
                const std::uint32_t set = materials[source.material].texcoord;
                std::ranges::copy(source.corner_texcoords(set, first),
                                  texcoords[i / 8].corner[lane]);
            }
        }
    });
}

namespace {

/// The geometries of an object with the numbers of their first triangles.
class TriangleList {
public:
    explicit TriangleList(const ObjectDescription& source) {
        std::size_t first = 0;
        for (const GeometryDescription& geometry : source.geometries) {
            runs_.push_back({first, geometry.indices.data(), geometry.positions.data()});
            first += geometry.indices.size() / 3;
        }
        count_ = first;
    }
    [[nodiscard]] std::size_t count() const { return count_; }

    /// Calls take(i, corners) for the triangles first + i, i < count.
    template <class Take>
    void for_each(std::size_t first, std::size_t count, const Take& take) const {
        auto next = std::ranges::upper_bound(runs_, first, {}, &Run::first);
        for (std::size_t i = 0; i < count; ++next) {
            const Run& run = *std::prev(next);
            const std::size_t end = next == runs_.end() ? count_ : next->first;
            const std::uint32_t* at = run.indices + 3 * (first + i - run.first);
            for (; i < count && first + i < end; ++i, at += 3) {
                take(i, Corners{run.positions[at[0]], run.positions[at[1]], run.positions[at[2]]});
            }
        }
    }

private:
    struct Run {
        std::size_t first;
        const std::uint32_t* indices;
        const Vec3* positions;
    };
    std::vector<Run> runs_;
    std::size_t count_ = 0;
};

}  // namespace

std::function<void(std::uint32_t, std::span<Box>)> triangle_boxes(const ObjectDescription& source) {
    return [list = TriangleList(source)](std::uint32_t first, std::span<Box> out) {
        list.for_each(first, out.size(), [&](std::size_t i, const Corners& at) {
            out[i] = {};
            for (const Vec3& corner : at) out[i].extend(corner);
        });
    };
}

PageVector<Corners> triangle_corners(const ObjectDescription& source) {
    const TriangleList list(source);
    PageVector<Corners> corners(list.count());
    using Part = tbb::blocked_range<std::size_t>;
    tbb::parallel_for(Part(0, list.count(), triangles_part), [&](const Part& part) {
        list.for_each(part.begin(), part.size(),
                      [&](std::size_t i, const Corners& at) { corners[part.begin() + i] = at; });
    });
    return corners;
}

namespace {

/// Writes an object's records in tree order with their original indices, then the inverse order.
void write_records(const ObjectDescription& source, const Tree& tree, std::uint32_t record_size,
                   std::byte* out) {
    const std::uint64_t stride = record_stride(record_size);
    std::byte* const places = out + tree.record_order.size() * stride;
    for (std::uint32_t place = 0; place < tree.record_order.size(); ++place) {
        const std::uint32_t original = tree.record_order[place];
        std::memcpy(out, source.records.data() + std::size_t{original} * record_size, record_size);
        std::memcpy(out + stride - sizeof original, &original, sizeof original);
        std::memcpy(places + original * sizeof place, &place, sizeof place);
        out += stride;
    }
}

}  // namespace

std::uint32_t NameTable::add(const std::string& name) {
    if (name.empty()) return 0;
    const std::string text = name.substr(0, name.find('\0'));
    const auto [at, added] = offsets_.try_emplace(text, static_cast<std::uint32_t>(bytes_.size()));
    if (added) (bytes_ += text) += '\0';
    return at->second;
}

std::uint64_t AttributePlan::add_alpha(std::span<const std::uint8_t> rgba) {
    return place({reinterpret_cast<const std::byte*>(rgba.data()) + 3, rgba.size() / 4, 4});
}

std::uint64_t AttributePlan::reserve(std::uint64_t bytes) {
    if (bytes == 0) return no_offset;
    const std::uint64_t offset = format::aligned(size_);
    size_ = offset + bytes;
    return offset;
}

std::uint64_t AttributePlan::place(Source source) {
    if (source.bytes == 0) return no_offset;
    source.offset = (size_ + attribute_alignment - 1) / attribute_alignment * attribute_alignment;
    size_ = source.offset + source.bytes;
    sources_.push_back(source);
    return source.offset;
}

void AttributePlan::write(std::byte* section) const {
    for (const Source& source : sources_) {
        std::byte* const out = section + source.offset;
        if (source.stride == 1) {
            std::memcpy(out, source.first, source.bytes);
        } else {
            for (std::uint64_t i = 0; i < source.bytes; ++i)
                out[i] = source.first[i * source.stride];
        }
    }
}

Arena write_arena(const Content& content) {
    std::uint64_t nodes = 0, blocks = 0, records = 0;
    for (const ObjectRecord& object : content.objects) {
        nodes += object.node_count;
        blocks += object.block_count;
        records += records_bytes(object);
    }
    const std::array<std::uint64_t, format::section_count> counts{
        nodes,
        blocks,
        records,
        content.objects.size(),
        content.instances.size(),
        content.instance_infos.size(),
        content.geometries.size(),
        content.materials.size(),
        content.textures.size(),
        content.cameras.size(),
        content.attributes.size(),
        content.names.bytes().size(),
        content.skips.size(),
        content.warnings.size(),
        content.record_types.size(),
        content.path_nodes.size(),
        content.path_runs.size(),
        content.instance_numbers.size(),
        content.surfaces.size(),
        content.geometry_shading.size(),
        content.texture_levels.size(),
        content.lights.size(),
        content.motion.size(),
    };

    format::Header header{format::magic,          format::version,
                          format::byte_order,     0,
                          content.build,          content.up,
                          content.chosen_variant, content.variants,
                          content.origin,         content.degenerate_triangles,
                          content.bounds,         {}};
    std::uint64_t end = format::aligned(sizeof header);
    for (std::size_t s = 0; s < format::section_count; ++s) {
        header.sections[s] = {end, counts[s], format::element_size[s], 0};
        end = format::aligned(end + counts[s] * format::element_size[s]);
    }
    header.bytes = end;

    Arena arena(end);
    std::byte* const base = arena.data();
    std::memcpy(base, &header, sizeof header);
    const auto at = [&](Section section) {
        return base + header.sections[static_cast<std::size_t>(section)].offset;
    };
    const auto copy = [&](Section section, const auto& elements) {
        if (elements.empty()) return;
        std::memcpy(at(section), elements.data(), elements.size() * sizeof(elements[0]));
    };
    copy(Section::objects, content.objects);
    copy(Section::instances, content.instances);
    copy(Section::instance_infos, content.instance_infos);
    copy(Section::geometries, content.geometries);
    copy(Section::materials, content.materials);
    copy(Section::textures, content.textures);
    copy(Section::cameras, content.cameras);
    copy(Section::names, content.names.bytes());
    copy(Section::skips, content.skips);
    copy(Section::warnings, content.warnings);
    copy(Section::record_types, content.record_types);
    copy(Section::path_nodes, content.path_nodes);
    copy(Section::path_runs, content.path_runs);
    copy(Section::instance_numbers, content.instance_numbers);
    copy(Section::surfaces, content.surfaces);
    copy(Section::geometry_shading, content.geometry_shading);
    copy(Section::texture_levels, content.texture_levels);
    copy(Section::lights, content.lights);
    copy(Section::motion, content.motion);
    content.attributes.write(at(Section::attributes));
    return arena;
}

void write_trees(const Content& content, Arena& arena) {
    const auto at = [&](Section section) {
        const auto& header = *reinterpret_cast<const format::Header*>(arena.data());
        return arena.data() + header.sections[static_cast<std::size_t>(section)].offset;
    };
    auto* const node_section = reinterpret_cast<Node*>(at(Section::nodes));
    auto* const block_section = reinterpret_cast<TriangleBlock*>(at(Section::blocks));
    for (std::size_t i = 0; i < content.objects.size(); ++i) {
        const ObjectRecord& object = content.objects[i];
        const Tree& tree = content.trees[i];
        std::copy(tree.nodes.begin(), tree.nodes.end(), node_section + object.first_node);
        const bool has_texcoords = object.texcoord_blocks != no_offset;
        write_blocks(*content.sources[i], tree,
                     {content.geometries.data() + object.first_geometry, object.geometry_count},
                     content.materials.data(), block_section + object.first_block,
                     has_texcoords ? reinterpret_cast<TexcoordBlock*>(at(Section::attributes) +
                                                                      object.texcoord_blocks)
                                   : nullptr);
        write_records(*content.sources[i], tree, object.record_size,
                      at(Section::records) + object.first_record);
    }
}

}  // namespace raynest

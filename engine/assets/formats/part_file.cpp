#include "engine/assets/formats/part_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>

namespace raynest {
namespace {

constexpr std::size_t position_bytes = 12, triangle_bytes = 12, face_bytes = 13;
constexpr std::size_t piece_items = 4096;

std::string ply_head(std::uint32_t vertices, std::uint32_t faces) {
    return fmt::format(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\n"
        "property float y\nproperty float z\nelement face {}\n"
        "property list uchar uint vertex_indices\nend_header\n",
        vertices, faces);
}

/// As numpy.save() writes it: the whole head has a multiple of 64 bytes.
std::string npy_head(std::uint64_t rows, std::uint64_t columns) {
    constexpr std::size_t begin_bytes = 10, unit = 64;
    std::string text = fmt::format(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}), }}", rows, columns);
    text.resize((begin_bytes + text.size() + unit) / unit * unit - begin_bytes - 1, ' ');
    text += '\n';
    return std::string("\x93NUMPY\x01\x00", 8) + static_cast<char>(text.size()) + '\0' + text;
}

std::span<const std::byte> bytes_of(const void* first, std::uint64_t count) {
    return {static_cast<const std::byte*>(first), static_cast<std::size_t>(count)};
}

bool write_bytes(const void* first, std::uint64_t count, const PartFile::Sink& sink) {
    constexpr std::uint64_t piece_bytes = 1 << 20;
    for (auto left = bytes_of(first, count); !left.empty();) {
        const auto piece = left.first(std::min<std::uint64_t>(left.size(), piece_bytes));
        if (!sink(piece)) return false;
        left = left.subspan(piece.size());
    }
    return true;
}

/// Passes `count` items of `bytes` bytes each, which `fill` writes.
template <class Fill>
void write_items(std::uint64_t count, std::size_t bytes, const PartFile::Sink& sink, Fill fill) {
    std::vector<std::byte> piece(bytes * std::min<std::uint64_t>(count, piece_items));
    for (std::uint64_t first = 0; first < count; first += piece_items) {
        const auto items =
            static_cast<std::size_t>(std::min<std::uint64_t>(count - first, piece_items));
        for (std::size_t i = 0; i < items; ++i) fill(first + i, piece.data() + bytes * i);
        if (!sink(std::span(piece).first(bytes * items))) return;
    }
}

}  // namespace

PartFile::PartFile(Form form, const SceneView& view, const ObjectRecord& object)
    : form_(form),
      view_(&view),
      object_(&object),
      geometry_(form == Form::npy ? nullptr : &view.geometries[object.first_geometry]) {
    if (form == Form::ply) head_ = ply_head(geometry_->vertex_count, geometry_->triangle_count);
    if (form == Form::npy)
        head_ = npy_head(object.record_count, object.record_size / sizeof(float));
}

std::uint64_t PartFile::bytes() const {
    if (form_ == Form::npy)
        return head_.size() + std::uint64_t{object_->record_count} * object_->record_size;
    return head_.size() + std::uint64_t{geometry_->vertex_count} * position_bytes +
           std::uint64_t{geometry_->triangle_count} *
               (form_ == Form::ply ? face_bytes : triangle_bytes);
}

void PartFile::write(const Sink& sink) const {
    if (!head_.empty() && !sink(bytes_of(head_.data(), head_.size()))) return;
    if (form_ == Form::npy) {
        const std::size_t bytes = object_->record_size;
        write_items(object_->record_count, bytes, sink, [&](std::uint64_t i, std::byte* to) {
            std::memcpy(to, view_->record_of(*object_, static_cast<std::uint32_t>(i)), bytes);
        });
        return;
    }
    const auto* const positions = view_->attribute<Vec3>(geometry_->positions);
    const auto* const indices = view_->attribute<std::uint32_t>(geometry_->indices);
    if (!write_bytes(positions, std::uint64_t{geometry_->vertex_count} * position_bytes, sink))
        return;
    if (form_ == Form::bin) {
        write_bytes(indices, std::uint64_t{geometry_->triangle_count} * triangle_bytes, sink);
        return;
    }
    write_items(geometry_->triangle_count, face_bytes, sink, [&](std::uint64_t i, std::byte* to) {
        *to = std::byte{3};
        std::memcpy(to + 1, indices + 3 * i, triangle_bytes);
    });
}

std::vector<PartFile> part_files(const SceneView& view, const ObjectRecord& object) {
    using Form = PartFile::Form;
    const std::uint64_t records = std::uint64_t{object.record_count} * object.record_size;
    if (records + std::uint64_t{object.triangle_count} * face_bytes < part_bytes_min) return {};
    if (object.geometry_count == 1 && object.triangle_count != 0)
        return {PartFile(Form::bin, view, object), PartFile(Form::ply, view, object)};
    if (object.record_count != 0 && object.record_size % sizeof(float) == 0)
        return {PartFile(Form::npy, view, object)};
    return {};
}

}  // namespace raynest

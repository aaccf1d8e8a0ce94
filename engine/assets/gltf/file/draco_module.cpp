// The only file that includes libdraco: a module of its own (draco.h).
#include "engine/assets/gltf/file/draco.h"

#include <draco/compression/decode.h>
#include <draco/core/varint_decoding.h>
#include <draco/metadata/metadata_decoder.h>
#include <fmt/format.h>

#include <optional>

namespace raynest::gltf {

namespace {

tl::unexpected<Error> refuse(const std::string& why) {
    return fail(ErrorCode::scene_invalid, why);
}

tl::unexpected<Error> too_large() {
    return fail(ErrorCode::limit_exceeded,
                "has Draco data that decodes to far more than valid data does");
}

/// Returns the number of faces that a stream declares; nothing if it has no valid header.
/// Draco allocates by this number before any further check.
std::optional<std::uint64_t> promised_faces(draco::DecoderBuffer in) {
    draco::DracoHeader header{};
    for (const char expected : {'D', 'R', 'A', 'C', 'O'}) {
        std::int8_t letter = 0;
        if (!in.Decode(&letter) || letter != expected) return std::nullopt;
    }
    if (!in.Decode(&header.version_major) || !in.Decode(&header.version_minor) ||
        !in.Decode(&header.encoder_type) || !in.Decode(&header.encoder_method) ||
        !in.Decode(&header.flags)) {
        return std::nullopt;
    }
    const int version = header.version_major << 8 | header.version_minor;
    in.set_bitstream_version(static_cast<std::uint16_t>(version));
    if ((header.flags & METADATA_FLAG_MASK) != 0) {
        draco::GeometryMetadata metadata;
        if (!draco::MetadataDecoder().DecodeGeometryMetadata(&in, &metadata)) return std::nullopt;
    }
    // Numbers have variable length from version 2.0 (edgebreaker) and 2.2 (sequential) on.
    const auto number = [&](int variable_since) -> std::optional<std::uint32_t> {
        std::uint32_t value = 0;
        const bool read =
            version < variable_since ? in.Decode(&value) : draco::DecodeVarint(&value, &in);
        return read ? std::optional(value) : std::nullopt;
    };
    if (header.encoder_method == draco::MESH_SEQUENTIAL_ENCODING) return number(0x0202);
    std::uint8_t traversal = 0;
    if (!in.Decode(&traversal)) return std::nullopt;
    if (version < 0x0202 && !number(0x0200)) return std::nullopt;  // split vertices
    if (!number(0x0200)) return std::nullopt;                      // vertices
    return number(0x0200);
}

template <class T>
bool convert(const draco::PointAttribute& attribute, std::uint32_t points, std::uint32_t width,
             std::vector<unsigned char>& out) {
    out.resize(std::uint64_t{points} * width * sizeof(T));
    // The allocator aligns for any type.
    T* to = reinterpret_cast<T*>(out.data());
    for (std::uint32_t i = 0; i < points; ++i, to += width) {
        const draco::AttributeValueIndex value = attribute.mapped_index(draco::PointIndex(i));
        if (value.value() >= attribute.size() ||
            !attribute.ConvertValue<T>(value, static_cast<std::int8_t>(width), to)) {
            return false;
        }
    }
    return true;
}

bool convert(const draco::PointAttribute& attribute, std::uint32_t points,
             const DracoAttribute& wanted, std::vector<unsigned char>& out) {
    switch (wanted.component) {
        case Component::i8:
            return convert<std::int8_t>(attribute, points, wanted.width, out);
        case Component::u8:
            return convert<std::uint8_t>(attribute, points, wanted.width, out);
        case Component::i16:
            return convert<std::int16_t>(attribute, points, wanted.width, out);
        case Component::u16:
            return convert<std::uint16_t>(attribute, points, wanted.width, out);
        case Component::u32:
            return convert<std::uint32_t>(attribute, points, wanted.width, out);
        case Component::f32:
            break;
    }
    return convert<float>(attribute, points, wanted.width, out);
}

Result<DracoMesh> decode(std::span<const std::byte> stream, std::span<const DracoAttribute> wanted,
                         std::uint64_t bytes_max) {
    constexpr std::uint64_t bytes_per_face = 3 * sizeof(std::uint32_t);
    draco::DecoderBuffer in;
    in.Init(reinterpret_cast<const char*>(stream.data()), stream.size());
    const auto faces = promised_faces(in);
    if (!faces) return refuse("has Draco data that is no Draco stream");
    if (*faces > bytes_max / bytes_per_face) return too_large();
    auto decoded = draco::Decoder().DecodeMeshFromBuffer(&in);
    if (!decoded.ok()) {
        return refuse(fmt::format("has Draco data that Draco cannot decode: {}",
                                  decoded.status().error_msg_string()));
    }
    const draco::Mesh& mesh = *decoded.value();

    if (mesh.num_faces() == 0 || mesh.num_points() == 0)
        return refuse("has Draco data without triangles");

    DracoMesh out;
    out.points = mesh.num_points();
    std::uint64_t bytes = std::uint64_t{mesh.num_faces()} * bytes_per_face;
    for (const DracoAttribute& attribute : wanted)
        bytes += std::uint64_t{out.points} * attribute.width * size_of(attribute.component);
    if (bytes > bytes_max) return too_large();

    out.indices.resize(std::uint64_t{mesh.num_faces()} * bytes_per_face);
    auto* to = reinterpret_cast<std::uint32_t*>(out.indices.data());
    for (draco::FaceIndex face(0); face < mesh.num_faces(); ++face) {
        for (const draco::PointIndex& point : mesh.face(face)) *to++ = point.value();
    }
    for (const DracoAttribute& attribute : wanted) {
        const draco::PointAttribute* const found = mesh.GetAttributeByUniqueId(attribute.id);
        if (found == nullptr)
            return refuse(fmt::format("has Draco data without attribute {}", attribute.id));
        if (found->num_components() != attribute.width) {
            return refuse(
                fmt::format("has a Draco attribute of {} components, but its accessor has "
                            "{}",
                            found->num_components(), attribute.width));
        }
        out.attributes.emplace_back();
        if (!convert(*found, out.points, attribute, out.attributes.back())) {
            return refuse(
                fmt::format("has a Draco attribute {} whose values do not fit its "
                            "accessor",
                            attribute.id));
        }
    }
    return out;
}

}  // namespace
}  // namespace raynest::gltf

extern "C" [[gnu::visibility("default")]] decltype(&raynest::gltf::decode_draco)
raynest_draco() noexcept {
    return raynest::gltf::decode;
}

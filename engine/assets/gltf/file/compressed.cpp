#include "engine/assets/gltf/file/compressed.h"

#include "engine/assets/gltf/file/draco.h"
#include "engine/assets/gltf/file/meshopt.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

namespace raynest::gltf {
namespace {

constexpr const char* draco_name = "KHR_draco_mesh_compression";
constexpr const char* meshopt_name = "EXT_meshopt_compression";

/// Valid geometry shrinks by 5 to 50 times. A file beyond this is made to use up memory.
constexpr std::uint64_t decompressed_bytes_free = 32ULL << 20;
constexpr std::uint64_t decompressed_bytes_per_byte = 256;

tl::unexpected<Error> refuse(const std::string& why) {
    return fail(ErrorCode::scene_invalid, why);
}

std::uint64_t bytes_left(const Model& model) {
    return decompressed_bytes_free + model.upload_bytes * decompressed_bytes_per_byte -
           model.decompressed_bytes;
}

/// Returns a whole number that is not negative, or `otherwise` if the member is absent; nothing if
/// the member is something else.
std::optional<std::uint64_t> number(const tinygltf::Value& object, const char* name,
                                    std::optional<std::uint64_t> otherwise = std::nullopt) {
    if (!object.Has(name)) return otherwise;
    const tinygltf::Value& value = object.Get(name);
    if (!value.IsInt() || value.GetNumberAsInt() < 0) return std::nullopt;
    return static_cast<std::uint64_t>(value.GetNumberAsInt());
}

std::string text(const tinygltf::Value& object, const char* name, const char* otherwise) {
    if (!object.Has(name)) return otherwise;
    return object.Get(name).IsString() ? object.Get(name).Get<std::string>() : std::string();
}

const std::byte* keep(Model& model, std::vector<unsigned char> bytes) {
    model.decompressed_bytes += bytes.size();
    model.decompressed.push_back(std::move(bytes));
    return std::as_bytes(std::span(model.decompressed.back())).data();
}

/// Adds a packed accessor of decoded bytes, with the type of `stated`.
std::uint32_t add_accessor(Model& model, const Accessor& stated, std::uint64_t count,
                           std::vector<unsigned char> bytes) {
    Accessor accessor;
    accessor.data = keep(model, std::move(bytes));
    accessor.count = count;
    accessor.width = stated.width;
    accessor.component = stated.component;
    accessor.normalized = stated.normalized;
    accessor.scalar_or_vector = stated.scalar_or_vector;
    accessor.stride = stated.width * size_of(stated.component);
    model.accessors.push_back(accessor);
    return static_cast<std::uint32_t>(model.accessors.size() - 1);
}

}  // namespace

const Decoder* find_decoder(std::string_view extension) {
    static const std::array<Decoder, 2> decoders{
        {{draco_name, draco_available}, {meshopt_name, meshopt_available}}};
    const auto found = std::find_if(decoders.begin(), decoders.end(), [&](const Decoder& decoder) {
        return decoder.extension == extension;
    });
    return found == decoders.end() ? nullptr : &*found;
}

bool is_compressed(const tinygltf::BufferView& view) {
    return view.extensions.contains(meshopt_name) && meshopt_available().has_value();
}

Result<View> decompress(const tinygltf::BufferView& view, Model& model) {
    const tinygltf::Value& extension = view.extensions.at(meshopt_name);
    const auto buffer = number(extension, "buffer");
    const auto offset = number(extension, "byteOffset", 0);
    const auto length = number(extension, "byteLength");
    const auto stride = number(extension, "byteStride");
    const auto count = number(extension, "count");
    if (!buffer || !offset || !length || !stride || !count)
        return refuse(fmt::format("has an {} with missing or invalid numbers", meshopt_name));
    const auto stream =
        check_view({static_cast<std::int64_t>(*buffer), *offset, *length, 0}, model.storage);
    if (!stream) return blame("is compressed, but its data", stream.error());
    const std::string mode = text(extension, "mode", "");
    const std::string filter = text(extension, "filter", "NONE");
    const MeshoptView compressed{stream->bytes, *count, *stride, mode, filter};
    const auto bytes = meshopt_bytes(compressed);
    if (!bytes) return error_of(bytes);
    if (*bytes > bytes_left(model)) {
        return fail(ErrorCode::limit_exceeded,
                    "is compressed, and the scene names the same data repeatedly");
    }
    auto decoded = decode_meshopt(compressed);
    if (!decoded) return error_of(decoded);
    return View{{keep(model, std::move(*decoded)), *bytes}, view.byteStride};
}

Result<void> decompress(const tinygltf::Primitive& from, Model& model, Primitive& to) {
    const auto found = from.extensions.find(draco_name);
    if (found == from.extensions.end()) return {};
    if (auto available = draco_available(); !available) {
        const bool has_fallback =
            to.position != no_id && model.accessors[to.position].data != nullptr;
        return has_fallback ? Result<void>() : available;
    }
    const auto view = number(found->second, "bufferView");
    if (!view || *view >= model.views.size() || !found->second.Has("attributes"))
        return refuse("has Draco data in a bufferView that does not exist");
    if (const std::string& fault = model.views[*view].fault; !fault.empty())
        return refuse("has Draco data in " + fault);
    const tinygltf::Value& ids = found->second.Get("attributes");

    std::vector<std::uint32_t*> places;
    std::vector<DracoAttribute> wanted;
    for (const auto& [name, place, is_for_shading] : attributes_of(to)) {
        const auto id = number(ids, name.c_str());
        if (!id || *place == no_id) continue;
        const Accessor& accessor = model.accessors[*place];
        if (is_for_shading && !accessor.fault.empty()) continue;  // left out where it is read
        wanted.push_back({static_cast<std::uint32_t>(*id), accessor.component, accessor.width});
        places.push_back(place);
    }
    auto mesh = decode_draco(model.views[*view].bytes, wanted, bytes_left(model));
    if (!mesh) return error_of(mesh);
    for (std::size_t i = 0; i < places.size(); ++i) {
        *places[i] = add_accessor(model, model.accessors[*places[i]], mesh->points,
                                  std::move(mesh->attributes[i]));
    }
    Accessor indices;
    indices.width = 1;
    indices.component = Component::u32;
    const std::uint64_t corners = mesh->indices.size() / sizeof(std::uint32_t);
    to.indices = add_accessor(model, indices, corners, std::move(mesh->indices));
    to.mode = 4;  // Draco has no strips: always triangles, whatever mode the file states
    return {};
}

}  // namespace raynest::gltf

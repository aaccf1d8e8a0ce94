// The only file that includes libmeshoptimizer. Its decoders check the stream but only assert their
// arguments (sizes, counts, strides), so these are checked here.
#include "engine/assets/gltf/file/meshopt.h"

#ifdef RAYNEST_MESHOPT
#include <meshoptimizer.h>
#endif

#include <fmt/format.h>

namespace raynest::gltf {
namespace {

/// Upper bound of the expansion. Attributes are densest: two bits of the stream hold at most 16
/// bytes.
constexpr std::uint64_t bytes_per_stream_byte_max = 64;
constexpr std::uint64_t attribute_stride_max = 256;

tl::unexpected<Error> damaged_view(const std::string& why) {
    return fail(ErrorCode::scene_invalid, why);
}

bool is_allowed_filter(const MeshoptView& view) {
    if (view.filter == "NONE") return true;
    if (view.mode != "ATTRIBUTES") return false;
    if (view.filter == "OCTAHEDRAL") return view.stride == 4 || view.stride == 8;
    if (view.filter == "QUATERNION") return view.stride == 8;
    return view.filter == "EXPONENTIAL";
}

}  // namespace

Result<std::uint64_t> meshopt_bytes(const MeshoptView& view) {
    const bool is_index = view.mode == "TRIANGLES" || view.mode == "INDICES";
    if (!is_index && view.mode != "ATTRIBUTES") return damaged_view("has an unknown meshopt mode");
    const bool stride_fits =
        is_index ? view.stride == 2 || view.stride == 4
                 : view.stride != 0 && view.stride % 4 == 0 && view.stride <= attribute_stride_max;
    if (!stride_fits)
        return damaged_view(fmt::format("has meshopt {} of {} bytes each", view.mode, view.stride));
    if (!is_allowed_filter(view)) {
        return damaged_view(fmt::format("has a meshopt filter that its {} of {} bytes do not allow",
                                        view.mode, view.stride));
    }
    if (view.count == 0 || (view.mode == "TRIANGLES" && view.count % 3 != 0))
        return damaged_view(fmt::format("has {} meshopt elements", view.count));
    if (view.count > view.stream.size() * bytes_per_stream_byte_max / view.stride) {
        return damaged_view(
            fmt::format("declares {} meshopt elements of {} bytes in {} bytes; it is "
                        "cut short or damaged",
                        view.count, view.stride, view.stream.size()));
    }
    return view.count * view.stride;
}

#ifdef RAYNEST_MESHOPT

Result<void> meshopt_available() {
    return {};
}

Result<std::vector<unsigned char>> decode_meshopt(const MeshoptView& view) {
    std::vector<unsigned char> out(view.count * view.stride);
    const auto* const bytes = reinterpret_cast<const unsigned char*>(view.stream.data());
    const std::size_t size = view.stream.size();
    const int fault =
        view.mode == "ATTRIBUTES"
            ? meshopt_decodeVertexBuffer(out.data(), view.count, view.stride, bytes, size)
        : view.mode == "TRIANGLES"
            ? meshopt_decodeIndexBuffer(out.data(), view.count, view.stride, bytes, size)
            : meshopt_decodeIndexSequence(out.data(), view.count, view.stride, bytes, size);
    if (fault != 0) return damaged_view("has meshopt data that is damaged");
    if (view.filter == "OCTAHEDRAL") meshopt_decodeFilterOct(out.data(), view.count, view.stride);
    if (view.filter == "QUATERNION") meshopt_decodeFilterQuat(out.data(), view.count, view.stride);
    if (view.filter == "EXPONENTIAL") meshopt_decodeFilterExp(out.data(), view.count, view.stride);
    return out;
}

#else

Result<void> meshopt_available() {
    return fail(
        ErrorCode::scene_unsupported,
        "EXT_meshopt_compression needs meshoptimizer: install libmeshoptimizer-dev and build "
        "RayNest again, or re-export without compression");
}

Result<std::vector<unsigned char>> decode_meshopt(const MeshoptView&) {
    return tl::unexpected<Error>(meshopt_available().error());
}

#endif

}  // namespace raynest::gltf

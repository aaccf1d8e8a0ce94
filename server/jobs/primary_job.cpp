#include "server/jobs/primary_job.h"

#include "engine/assets/images/image.h"
#include "engine/integrators/picture.h"
#include "server/jobs/services.h"

#include <array>
#include <cstring>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Bytes per pixel: linear RGBA, and the 8-bit form or the planes and rows of an EXR. An encoded
/// file is at most as large as its input, and exists up to three times while it grows or is copied.
constexpr std::uint64_t pixel_bytes(std::string_view encode) {
    constexpr std::uint64_t rgba = 4;
    if (encode == "exr") return 6 * sizeof(Vec4);
    return sizeof(Vec4) + (encode == "png" ? 4 : 2) * rgba;
}

Result<std::vector<std::byte>> encode_linear_exr(std::uint32_t width, std::uint32_t height,
                                                 std::span<const Vec4> pixels,
                                                 std::span<const Attribute> attributes) {
    constexpr std::array<std::string_view, 4> names = {"R", "G", "B", "A"};
    std::array<std::vector<float>, 4> planes;
    std::array<Channel, 4> channels;
    for (int i = 0; i < 4; ++i) {
        auto& plane = planes[static_cast<std::size_t>(i)];
        plane.reserve(pixels.size());
        // Premultiply colours by alpha, as EXR requires; the background becomes 0.
        for (const Vec4& pixel : pixels) plane.push_back(pixel[i] * (i < 3 ? pixel.w : 1));
        channels[static_cast<std::size_t>(i)] = {names[static_cast<std::size_t>(i)], plane, {}};
    }
    return encode_exr(width, height, channels, attributes);
}

class PrimaryJob final : public PictureJob {
public:
    PrimaryJob(const Services& services, const Caller& caller, PictureRequest asked)
        : PictureJob(services, caller, std::move(asked)) {}

protected:
    void make_arrays() override { pixels_ = blank<Vec4>(); }
    [[nodiscard]] CastPlans plans() const override { return {&plan_}; }
    std::optional<CameraHits> trace_pixels(const PixelRange& pixels, const ColumnSource& scene,
                                           RayCaster& caster, const PixelArrays& arrays) override {
        std::vector<Vec4> colours(pixels.count);
        const auto seen = render_primary(pixels, scene, caster, arrays, colours);
        if (seen) place<Vec4>(pixels.first, colours, pixels_.get());
        return seen;
    }

    Reply<Payload> encode() override {
        Payload payload{request().width, request().height, {}};
        const std::span<const Vec4> pixels(pixels_.get(), request().pixels());
        std::vector<Attribute> attributes = provenance();
        attributes.push_back({"raynest:integrator", "primary"});
        if (request().encode == "exr") {
            auto file = encode_linear_exr(payload.width, payload.height, pixels, attributes);
            if (!file) return refuse(file.error());
            payload.bytes = std::move(*file);
            return payload;
        }
        const Picture picture = to_picture(payload.width, payload.height, pixels);
        if (request().encode == "png") {
            auto file = encode_png(picture.width, picture.height, picture.rgba, attributes);
            if (!file) return refuse(file.error());
            payload.bytes = std::move(*file);
        } else {
            payload.bytes.resize(picture.rgba.size());
            std::memcpy(payload.bytes.data(), picture.rgba.data(), picture.rgba.size());
        }
        return payload;
    }

private:
    std::unique_ptr<Vec4[]> pixels_;
};

}  // namespace

std::uint64_t primary_job_bytes(std::uint64_t pixels, std::string_view encode) {
    return image_header_bytes_max + pixel_bytes(encode) * pixels;
}

std::uint64_t primary_payload_bytes_max(std::uint32_t width, std::uint32_t height,
                                        std::string_view encode) {
    if (encode == "png") return png_bytes_max(width, height);
    if (encode == "exr") return exr_bytes_max(width, height, 4);
    return std::uint64_t{4} * width * height;
}

std::unique_ptr<Job> primary_job(const Services& services, const Caller& caller,
                                 PictureRequest asked) {
    return std::make_unique<PrimaryJob>(services, caller, std::move(asked));
}

}  // namespace raynest::server

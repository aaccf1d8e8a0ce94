// RENDER: a picture from a camera.
#include "engine/assets/image.h"
#include "engine/integrators/picture.h"
#include "server/jobs/explain_job.h"
#include "server/jobs/film_job.h"
#include "server/requests/request.h"
#include "server/requests/words/idle_options.h"
#include "server/jobs/picture_job.h"

#include <array>
#include <cstring>
#include <memory>

namespace raynest::server {
namespace {

/// Bytes per pixel: linear RGBA, and the 8-bit form or the planes and rows of an EXR. An encoded
/// file is at most as large as its input, and exists up to three times while it grows or is copied.
constexpr std::uint64_t pixel_bytes(std::string_view encode) {
    constexpr std::uint64_t rgba = 4;
    if (encode == "exr") return 6 * sizeof(Vec4);
    return sizeof(Vec4) + (encode == "png" ? 4 : 2) * rgba;
}
/// Returns the maximum bytes of the payload.
std::uint64_t payload_bytes_max(std::uint32_t width, std::uint32_t height,
                                std::string_view encode) {
    if (encode == "png") return png_bytes_max(width, height);
    if (encode == "exr") return exr_bytes_max(width, height, 4);
    return std::uint64_t{4} * width * height;
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

class RenderJob final : public PictureJob {
public:
    RenderJob(const Services& services, const Caller& caller, PictureRequest asked)
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

/// A picture of samples, by one of the integrators of engine/integrators/LIST.
Reply<Answer> render_film(const Services& services, const Caller& caller,
                          const wire::Render& message, std::string integrator) {
    auto options = film_options(message, std::move(integrator));
    if (!options) return tl::unexpected(options.error());
    auto plan = make_plan(services, caller, *message.job(), query_closest, counters_none, true);
    if (!plan) return tl::unexpected(plan.error());
    if (std::string note = idle_options_note(message, options->integrator); !note.empty())
        plan->notes.push_back(std::move(note));
    auto any = Plan::with(*plan, query_any, counters_none);
    if (!any) return tl::unexpected(any.error());
    const ImageSize size{message.width(), message.height()};
    const std::uint64_t rays = size.pixels() * options->samples;
    const Plan* others[] = {&*any};
    if (auto chosen = choose_backends(services.backends, rays, *plan, others); !chosen)
        return tl::unexpected(chosen.error());
    any->worker = plan->worker;
    const std::string_view encode = protocol::word(message.encode(), "png");
    // Only films have linear values; they are sent as raw ones are.
    auto request = make_request(services, caller, std::move(*plan), message.camera(), size.width,
                                size.height, encode == "linear" ? "raw" : encode,
                                film_job_bytes(size, encode, *options));
    if (!request) return tl::unexpected(request.error());
    request->encode = encode;
    JobSubmission accepted = accept(request->plan, "render", rays);
    accepted.detail = options->integrator;
    accepted.advice = smaller_picture(request->encode);
    accepted.input_bytes = options->resume_bytes + options->environment_bytes;
    accepted.answer_bytes =
        payload_answer_bytes(caller, film_payload_bytes_max(size, request->encode));
    // A detached job keeps its latest picture while it makes the next one.
    accepted.result_bytes = 3 * accepted.answer_bytes;
    accepted.job = std::make_unique<FilmJob>(services, caller, std::move(*request),
                                             std::move(*any), std::move(*options));
    return Answer{std::move(accepted)};
}

}  // namespace

Reply<Answer> render(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Render>& message) {
    const std::string_view form = protocol::text(message->encode());
    if (form.starts_with(path_encoding))
        return explain_path(services, caller, *message.table, form.substr(path_encoding.size()));
    const std::string_view integrator = protocol::word(message->integrator(), "primary");
    if (integrator != "primary")
        return render_film(services, caller, *message.table, std::string(integrator));
    if (message->resume_bytes() != 0 || message->environment_bytes() != 0)
        return refuse(Code::invalid_field,
                      "primary takes no files: nothing lights it, and it has no samples to continue");
    auto plan = make_plan(services, caller, *message->job(), query_closest);
    if (!plan) return tl::unexpected(plan.error());
    const std::uint64_t pixels = std::uint64_t{message->width()} * message->height();
    if (auto chosen = choose_backends(services.backends, pixels, *plan); !chosen)
        return tl::unexpected(chosen.error());
    if (message->samples() > 1)
        plan->notes.push_back("primary traces one ray per pixel, whatever `samples` says");
    if (std::string note = idle_options_note(*message.table, integrator); !note.empty())
        plan->notes.push_back(std::move(note));

    const std::string_view encode = protocol::word(message->encode(), "png");
    auto request = make_request(services, caller, std::move(*plan), message->camera(),
                                message->width(), message->height(), encode,
                                image_header_bytes_max + pixel_bytes(encode) * pixels);
    if (!request) return tl::unexpected(request.error());
    JobSubmission accepted = accept(request->plan, "render", request->rays());
    accepted.advice = smaller_picture(request->encode);
    accepted.answer_bytes = accepted.result_bytes = payload_answer_bytes(
        caller, payload_bytes_max(request->width, request->height, request->encode));
    accepted.job = std::make_unique<RenderJob>(services, caller, std::move(*request));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server

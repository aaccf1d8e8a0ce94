// The rays of a sample of a pixel, as the integrator asks for them.
#include "server/requests/explain_light_path.h"

#include "engine/geometry/tile_order.h"
#include "engine/integrators/camera.h"
#include "engine/integrators/integrator.h"
#include "server/documents/light_path_json.h"
#include "server/execution/choose_backends.h"
#include "server/execution/chunk_caster.h"
#include "server/jobs/explain_job.h"
#include "server/jobs/films/light_notes.h"
#include "server/jobs/ray_source.h"
#include "server/requests/words/explain_request.h"
#include "server/requests/words/film_options.h"
#include "server/requests/words/idle_options.h"
#include "server/requests/words/make_plan.h"

#include <charconv>
#include <cstddef>
#include <memory>
#include <string>
#include <system_error>
#include <utility>

namespace raynest::server {
namespace {

/// Returns the place of a pixel in the tile order.
std::uint64_t place_of(std::uint64_t x, std::uint64_t y, const ImageSize& size) {
    std::uint64_t place = y / 8 * 8 * size.width;
    while (tile_order(place, size.width, size.height) != y * size.width + x) ++place;
    return place;
}

class PathExplanationJob final : public ExplainJob {
public:
    PathExplanationJob(const Services& services, const Caller& caller, Plan closest, Plan any,
                       const Camera& camera, const IntegratorSettings& settings,
                       PathContext context, Budget::Lease lease)
        : ExplainJob(services, caller, std::move(closest), camera.name, std::move(lease)),
          any_(std::move(any)),
          size_{context.width, context.height},
          sensor_(camera_sensor(camera, {}, size_)),
          settings_(settings),
          context_(std::move(context)) {
        context_.camera = camera_;
    }

private:
    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override {
        const Snapshot& scene = plan_.scene.snapshot();
        const auto integrator = make_integrator(context_.integrator,
                                                {plan_.source(services_.registry),
                                                 scene.framed_bounds(),
                                                 &scene.shading(),
                                                 {},
                                                 &plan_.view(),
                                                 plan_.mask},
                                                settings_);
        if (!integrator) return tl::unexpected(to_wire(integrator.error()));
        ChunkCaster caster({&plan_, &any_}, chunk.backend, stop, buffers);
        PathRecorder recorder(caster);
        const SampleRange range{sensor_, place_of(context_.pixel[0], context_.pixel[1], size_),
                                1,       context_.sample,
                                1,       context_.seed};
        Wavefront wavefront;
        FilmSample sample;
        if (!(*integrator)->render(range, recorder, wavefront, {&sample, 1}))
            return tl::unexpected(caster.failure());
        JobStatistics::Counts counts;
        for (const PathRay& ray : recorder.rays()) {
            ++counts.rays;
            ++(ray.hit.hit != 0 || ray.blocked ? counts.hits : counts.misses);
        }
        finish(chunk, caster.traversal(), counts,
               path_json(plan_, context_, sample, recorder.rays()),
               light_notes(**integrator, scene, services_.limits));
        return Frames{};
    }

    const Plan any_;
    const ImageSize size_;
    const Sensor sensor_;
    const IntegratorSettings settings_;
    PathContext context_;
};

/// Reads "480,270".
Reply<Pixel> read_pixel(std::string_view text) {
    Pixel pixel{};
    const char* at = text.data();
    const char* const end = at + text.size();
    for (std::size_t i = 0; i < pixel.size(); ++i) {
        if (i != 0 && (at == end || *at++ != ',')) break;
        const auto [next, error] = std::from_chars(at, end, pixel[i]);
        if (error != std::errc{}) break;
        at = next;
        if (i == 1 && at == end) return pixel;
    }
    return refuse(Code::invalid_field,
                  "encode path+" + std::string(text) + " does not name a pixel as path+480,270");
}

}  // namespace

Reply<Answer> explain_path(const Services& services, const Caller& caller, RenderWords words) {
    const auto [width, height] = words.pixels.whole;
    if (words.integrator == "primary")
        return refuse(
            Code::invalid_field,
            "primary has one ray and no path: Explain tells its traversal; or use one of " +
                integrator_names());
    if (words.environment_bytes != 0 || words.resume_bytes != 0)
        return refuse(Code::unsupported,
                      "a path is explained without files: use environment auto, sky or none");
    const auto pixel = read_pixel(words.encode.substr(path_encoding.size()));
    if (!pixel) return tl::unexpected(pixel.error());
    if (const auto inside = check_pixel(*pixel, width, height); !inside)
        return tl::unexpected(inside.error());
    auto options = film_options(words);
    if (!options) return tl::unexpected(options.error());

    auto plan =
        make_plan(services, caller, std::move(words.job), query_closest, counters_none, true);
    if (!plan) return tl::unexpected(plan.error());
    if (std::string note = idle_options_note(words); !note.empty())
        plan->notes.push_back(std::move(note));
    if (plan->detach)
        return refuse(Code::invalid_field, "a path is explained at once: leave `detach` out");
    auto any = Plan::with(*plan, query_any, counters_none);
    if (!any) return tl::unexpected(any.error());
    const Plan* others[] = {&*any};
    if (auto chosen = choose_backends(services.backends, 1, *plan, others); !chosen)
        return tl::unexpected(chosen.error());
    any->backends = plan->backends;
    const auto camera = choose_camera(plan->scene.snapshot(), words.camera);
    if (!camera) return refuse(Code::invalid_field, camera.error().message);

    constexpr std::string_view fewer = "ask for a smaller `depth`";
    auto lease = reserve_explanation(services, caller, 2ULL * (options->settings.depth + 2), fewer);
    if (!lease) return tl::unexpected(lease.error());
    PathContext context{
        services.limits,     {}, *pixel, width, height, options->integrator, options->seed,
        options->samples - 1};
    JobSubmission accepted = accept_explanation(caller, *plan, lease->bytes(), fewer);
    accepted.job = std::make_unique<PathExplanationJob>(services, caller, std::move(*plan),
                                                        std::move(*any), *camera, options->settings,
                                                        std::move(context), std::move(*lease));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server

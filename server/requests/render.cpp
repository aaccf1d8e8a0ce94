// RENDER: a picture from a camera.
#include "server/documents/film_file.h"
#include "server/execution/choose_backends.h"
#include "server/jobs/films/film_job.h"
#include "server/jobs/films/film_tiles.h"
#include "server/jobs/primary_job.h"
#include "server/requests/explain_light_path.h"
#include "server/requests/request.h"
#include "server/requests/words/film_options.h"
#include "server/requests/words/idle_options.h"
#include "server/requests/words/make_plan.h"
#include "server/requests/words/picture_request.h"

#include <memory>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

/// Fails where the pixels of a tile would not be those of the whole picture.
Reply<void> check_tile(const RenderWords& words, const FilmOptions& options) {
    const AskedPixels& pixels = words.pixels;
    const PixelWindow& tile = pixels.window;
    if (tile.is_whole()) return {};
    if (!options.look.exposure && (words.encode == "png" || words.encode == "raw"))
        return refuse(Code::invalid_field,
                      "exposure auto looks at the whole picture, which a tile does not see: give "
                      "`exposure` in stops, or ask for encode exr or linear");
    const auto even = [](std::uint32_t first, std::uint32_t count, std::uint32_t whole,
                         std::uint32_t step) {
        return first % step == 0 && (count % step == 0 || first + count == whole);
    };
    if (options.noise > 0 &&
        !(even(tile.x, tile.size.width, pixels.whole.width, FilmTiles::columns) &&
          even(tile.y, tile.size.height, pixels.whole.height, FilmTiles::rows)))
        return refuse(Code::invalid_field,
                      "`noise` decides for blocks of 64 x 8 pixels together: begin and end the "
                      "tile at multiples of 64 and 8, or at the edge");
    return {};
}

/// A picture of samples, by one of the integrators of engine/integrators/integrators.def.
Reply<Answer> render_film(const Services& services, const Caller& caller, RenderWords words) {
    auto options = film_options(words);
    if (!options) return tl::unexpected(options.error());
    auto plan =
        make_plan(services, caller, std::move(words.job), query_closest, counters_none, true);
    if (!plan) return tl::unexpected(plan.error());
    if (std::string note = idle_options_note(words); !note.empty())
        plan->notes.push_back(std::move(note));
    auto any = Plan::with(*plan, query_any, counters_none);
    if (!any) return tl::unexpected(any.error());
    const ImageSize size = words.pixels.size();
    if (auto good = check_tile(words, *options); !good) return tl::unexpected(good.error());
    const std::uint64_t rays = size.pixels() * options->samples;
    const Plan* others[] = {&*any};
    if (auto chosen = choose_backends(services.backends, rays, *plan, others); !chosen)
        return tl::unexpected(chosen.error());
    any->backends = plan->backends;
    const std::string_view encode = words.encode;
    // Only films have linear values; they are sent as raw ones are.
    auto request =
        make_request(services, caller, std::move(*plan), words.camera, words.pixels,
                     encode == "linear" ? "raw" : encode, film_job_bytes(size, encode, *options));
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
    accepted.job = std::make_unique<FilmJob>(services, caller, std::move(*request), std::move(*any),
                                             std::move(*options));
    return Answer{std::move(accepted)};
}

}  // namespace

Reply<Answer> render(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Render>& message) {
    RenderWords words = render_words(*message.table);
    if (words.encode.starts_with(path_encoding)) {
        if (!words.pixels.window.is_whole())
            return refuse(Code::invalid_field, "encode path+X,Y is of one pixel: ask for no tile");
        return explain_path(services, caller, std::move(words));
    }
    if (words.integrator != "primary") return render_film(services, caller, std::move(words));
    if (words.resume_bytes != 0 || words.environment_bytes != 0)
        return refuse(
            Code::invalid_field,
            "primary takes no files: nothing lights it, and it has no samples to continue");
    auto plan = make_plan(services, caller, std::move(words.job), query_closest);
    if (!plan) return tl::unexpected(plan.error());
    const std::uint64_t pixels = words.pixels.size().pixels();
    if (auto chosen = choose_backends(services.backends, pixels, *plan); !chosen)
        return tl::unexpected(chosen.error());
    if (std::string note = idle_options_note(words); !note.empty())
        plan->notes.push_back(std::move(note));

    auto request = make_request(services, caller, std::move(*plan), words.camera, words.pixels,
                                words.encode, primary_job_bytes(pixels, words.encode));
    if (!request) return tl::unexpected(request.error());
    JobSubmission accepted = accept(request->plan, "render", request->rays());
    accepted.advice = smaller_picture(request->encode);
    accepted.answer_bytes = accepted.result_bytes = payload_answer_bytes(
        caller, primary_payload_bytes_max(request->width, request->height, request->encode));
    accepted.job = primary_job(services, caller, std::move(*request));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server

#include "server/jobs/picture_job.h"

#include "engine/assets/images/image.h"
#include "engine/packs/registry.h"
#include "protocol/answer.h"
#include "protocol/hash.h"
#include "protocol/text.h"
#include "server/documents/plan_text.h"
#include "server/documents/scene_info.h"
#include "server/jobs/ray_source.h"
#include "server/jobs/services.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <sstream>
#include <utility>

namespace raynest::server {
namespace {

/// True if the request's mask shares no bit with any instance of the scene.
bool mask_hides_all(const Plan& plan) {
    const SceneView& view = plan.scene.snapshot().view();
    const std::span instances(view.instances, view.instance_count);
    return !instances.empty() && std::ranges::none_of(instances, [&](const InstanceRecord& one) {
        return (one.mask & plan.mask) != 0;
    });
}

}  // namespace

PictureJob::PictureJob(const Services& services, const Caller& caller, PictureRequest request)
    : PictureJob(services, caller, std::move(request), request.pixels()) {
    queue_.add(0, request_.pixels());
}

PictureJob::PictureJob(const Services& services, const Caller& caller, PictureRequest request,
                       std::uint64_t total)
    : ChunkedJob(services, caller, std::move(request.plan), total, false),
      request_(std::move(request)),
      sensor_(camera_sensor(request_.camera, {}, request_.whole)),
      payload_(services.limits, caller, request_.encode) {}

Frames PictureJob::greeting() {
    wire::StartedT message = started(plan_, services_.limits);
    message.camera = protocol::clean_text(request_.camera.name, services_.limits.name_bytes_max);
    Frames frames;
    frames.push_back(protocol::answer(id_, message));
    return frames;
}

std::optional<Task> PictureJob::next() {
    switch (stage_) {
        case Stage::tracing:
            if (auto work = next_work()) {
                ++chunks_running_;
                return std::move(work->task);
            }
            return std::nullopt;
        case Stage::encoding:
            if (std::exchange(encode_started_, true)) return std::nullopt;
            return encode_task();
        case Stage::sending:
            return payload_.next();
    }
    return std::nullopt;
}

Reply<void> PictureJob::ended() {
    if (stage_ == Stage::tracing && --chunks_running_ == 0 && queue_.all_answered())
        stage_ = Stage::encoding;
    else if (stage_ == Stage::encoding)
        stage_ = Stage::sending;
    else
        payload_.ended();
    return {};
}

bool PictureJob::finished() const {
    return stage_ == Stage::sending && payload_.finished();
}

Frames PictureJob::farewell() {
    Frames frames;
    frames.push_back(protocol::answer(id_, done_));
    return frames;
}

std::string PictureJob::hint(std::uint64_t rays) const {
    const Snapshot& scene = plan_.scene.snapshot();
    const auto line = [&](const std::string& sees) {
        return protocol::clean_text("camera '" + request_.camera.name + "' sees " + sees,
                                    services_.limits.text_bytes_max);
    };
    if (scene.bounds().is_empty()) return line("nothing: the scene is empty");
    // A picture that was continued or cut short may have traced a few of its pixels only.
    if (rays < request_.pixels()) return {};
    const bool nothing = statistics_.hits() == 0;
    if (nothing && mask_hides_all(plan_))
        return line(plan_.mask == Plan{}.mask
                        ? "nothing: all instances are hidden by masks of their own"
                        : "nothing: no instance shares a bit with `mask` " + mask_text(plan_.mask));
    // True if all rays hit, more than 99 % of them a back side, as from inside a closed surface.
    const bool backs = plan_.query == query_closest && statistics_.hits() == request_.rays() &&
                       backs_ > request_.rays() / 100 * 99;
    if (!nothing && !backs) return {};
    if (nothing && request_.camera.name == "automatic" && scene.view().camera_count == 0 &&
        !plan_.time)
        return line("nothing, though it frames the scene: " + hides());
    const Framing view = framing(scene.bounds(), scene.up());
    const WorldPoint& origin = scene.origin();
    std::ostringstream lookat;
    lookat.precision(origin == WorldPoint{} ? 9 : 15);
    for (const glm::dvec3& point : {view.eye, view.at}) {
        for (int i = 0; i < 3; ++i)
            lookat << (lookat.tellp() == 0 ? "" : ",")
                   << origin[static_cast<std::size_t>(i)] + point[i];
    }
    return line((nothing ? "nothing" : "only backs of surfaces, as from inside of them") +
                std::string("; to frame the scene take `look_at` ") + lookat.str());
}

std::string PictureJob::hides() const {
    std::vector<std::string> causes;
    if (plan_.mask != Plan{}.mask) causes.emplace_back("`mask`");
    if (plan_.selected) causes.emplace_back("what is hidden or chosen");
    if (plan_.variant->name != "opaque") causes.push_back("the intersector " + plan_.variant->name);
    if (causes.empty()) return "no ray met anything; ask for more pixels";
    return fmt::format("{} leaves nothing to see, or the parts are too small for its pixels",
                       fmt::join(causes, " or "));
}

std::vector<Attribute> PictureJob::provenance() const {
    const auto text = [&](const std::string& words) {
        return protocol::clean_text(words, services_.limits.name_bytes_max);
    };
    const auto number = [](auto value) {
        std::array<char, 64> digits{};
        char* const end = digits.data() + digits.size();
        return std::string(digits.data(), std::to_chars(digits.data(), end, value).ptr);
    };
    std::string pose;
    for (const float element : request_.camera.to_world.m)
        pose.append(pose.empty() ? "" : " ").append(number(element));
    std::vector<Attribute> attributes = {{"Software", "RayNest " RAYNEST_VERSION},
                                         {"raynest:scene", text(plan_.scene.name)},
                                         {"raynest:hash", plan_.scene.snapshot().digest()},
                                         {"raynest:epoch", number(plan_.scene.epoch)},
                                         {"raynest:intersector", text(plan_.variant->name)},
                                         {"raynest:settings", text(settings_text(plan_))},
                                         {"raynest:mask", number(plan_.mask)},
                                         {"raynest:camera", text(request_.camera.name)},
                                         {"raynest:camera_to_world", pose}};
    if (plan_.time) attributes.push_back({"raynest:time", number(*plan_.time)});
    if (!plan_.animation.empty())
        attributes.push_back({"raynest:animation", text(plan_.animation)});
    if (const PixelWindow& tile = request_.window; !tile.is_whole()) {
        attributes.push_back({"raynest:request", request_.request});
        attributes.push_back(
            {"raynest:arithmetic", std::string(arithmetic_of(plan_.variant->target))});
        attributes.push_back({"raynest:tile", number(tile.x) + " " + number(tile.y) + " " +
                                                  number(tile.size.width) + " " +
                                                  number(tile.size.height) + " of " +
                                                  number(request_.whole.width) + "x" +
                                                  number(request_.whole.height)});
    }
    return attributes;
}

std::optional<Progress> PictureJob::progress() const {
    if (stage_ == Stage::tracing) return Progress{queue_.answered(), request_.pixels(), "tracing"};
    if (stage_ == Stage::encoding) return Progress{0, 0, "encoding"};
    return Progress{payload_.sent(), payload_.total(), "sending"};
}

Reply<void> PictureJob::make_ready(const Stop& stop) {
    if (is_image(file_word()))
        if (const auto images = images_available(); !images)
            return refuse(Code::unsupported, images.error().message + "; or ask for encode raw");
    return ChunkedJob::make_ready(stop);
}

std::uint64_t PictureJob::chunk_size(const Backend& backend, const Chunk& /*rest*/) const {
    return std::max<std::uint64_t>(1, backend.call_rays_max(plan_) / request_.samples);
}

PixelArrays PictureJob::arrays_for(const PixelRange& pixels, const CastPlans& plans,
                                   TraceBuffers& buffers) {
    buffers.resize(buffers.rays, pixels.rays());
    buffers.resize(buffers.hits, pixels.rays());
    const std::uint32_t sets = plans.counted == nullptr ? 0 : plans.counted->counter_sets();
    buffers.resize(buffers.counters, pixels.rays() * sets);
    return {buffers.rays, buffers.hits, buffers.counters, sets};
}

Traced<Frames> PictureJob::trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) {
    std::call_once(arrays_made_, [this] { make_arrays(); });
    const PixelRange pixels{sensor_, chunk.first, chunk.count, request_.samples, request_.window};
    const CastPlans by = plans();
    ChunkCaster caster(by, chunk.backend, stop, buffers);
    const auto seen = trace_pixels(pixels, plan_.source(services_.registry), caster,
                                   arrays_for(pixels, by, buffers));
    if (!seen) return tl::unexpected(caster.failure());
    const auto again = trace_again(pixels, chunk.backend, stop, buffers);
    if (!again) return tl::unexpected(again.error());
    JobStatistics::Counts counts;
    counts.rays = seen->rays;
    counts.hits = seen->hits;
    counts.misses = seen->rays - seen->hits;
    statistics_.add(chunk.backend, 1U << caster.traversal(), counts);
    backs_ += seen->backs;
    count_rays("picture", chunk, seen->rays + *again);
    queue_.answered(chunk.count);
    return Frames{};
}

Task PictureJob::encode_task() {
    Task task;
    task.run = [this](const Stop& stop) -> Reply<Frames> {
        // Check before encoding, which cannot be interrupted: a large PNG takes a second.
        if (stop.requested()) return refuse(Code::cancelled, "");
        auto payload = encode();
        if (!payload) return tl::unexpected(payload.error());
        payload_.set(std::move(*payload));
        done_ = done();
        complete(done_);
        std::string line = hint(done_.rays);
        if (!request_.window.is_whole())
            done_.note_of_all = std::move(line);
        else if (!line.empty())
            done_.notes.push_back(std::move(line));
        return Frames{};
    };
    return task;
}

}  // namespace raynest::server
